//! The files of the page, which the build has put into the program.

use super::media::media;
use crate::answer;
use crate::fault::{Fault, FaultKind};
use crate::header_text;
use axum::body::Body;
use axum::extract::Path;
use axum::http::{HeaderMap, HeaderValue, Response, StatusCode, header};
use std::hash::{DefaultHasher, Hash as _, Hasher as _};

include!(concat!(env!("OUT_DIR"), "/page.rs"));

/// Content security policy of the page: only its own files and what it creates itself.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; \
    connect-src 'self' blob: data:; worker-src 'self' blob:; font-src 'self'; manifest-src 'self'; \
    base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

pub(super) async fn index(headers: HeaderMap) -> Result<Response<Body>, Fault> {
    find("index.html", &headers)
}

pub(super) async fn file(
    Path(name): Path<String>,
    headers: HeaderMap,
) -> Result<Response<Body>, Fault> {
    find(&name, &headers)
}

fn find(name: &str, headers: &HeaderMap) -> Result<Response<Body>, Fault> {
    let mut files = FILES.iter();
    let Some((_, bytes)) = files.find(|(own, _)| *own == name) else {
        return Err(Fault::new(FaultKind::NotFound, "the page has no such file"));
    };
    let mut hasher = DefaultHasher::new();
    bytes.hash(&mut hasher);
    let tag = format!("\"{:016x}\"", hasher.finish());
    let known = header_text(headers, header::IF_NONE_MATCH);
    let mut tags = known.unwrap_or_default().split(',').map(str::trim);
    let mut response = if tags.any(|known| known == tag || known == "*") {
        let mut unchanged = Response::new(Body::empty());
        *unchanged.status_mut() = StatusCode::NOT_MODIFIED;
        unchanged
    } else {
        answer::text(media(name), *bytes)
    };
    let headers = response.headers_mut();
    headers.extend(
        HeaderValue::try_from(tag)
            .ok()
            .map(|tag| (header::ETAG, tag)),
    );
    for (name, value) in [
        // Kept, but asked for each time: another version has other files.
        (header::CACHE_CONTROL, "no-cache"),
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::X_FRAME_OPTIONS, "DENY"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    Ok(response)
}
