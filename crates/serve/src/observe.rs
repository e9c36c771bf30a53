//! The wrapper of every request: identifier, access control, panics, faults as JSON, metrics, and log.

use crate::answer;
use crate::app::App;
use crate::config::LogEntry;
use crate::fault::{Fault, FaultKind};
use crate::guard::Verdict;
use crate::header_text;
use crate::metrics::Scalar;
use axum::body::Body;
use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Response, StatusCode, header};
use axum::middleware::Next;
use futures_util::FutureExt as _;
use serde_json::json;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant, SystemTime};

/// The header with the name of a request.
const REQUEST: HeaderName = HeaderName::from_static("x-request-id");

/// The longest name that a client may give its request.
const LONGEST: usize = 64;

/// Answers a request within all that surrounds it.
pub(crate) async fn observe(
    State(app): State<Arc<App>>,
    request: Request,
    next: Next,
) -> Response<Body> {
    let name = name(request.headers());
    let route = request.extensions().get::<MatchedPath>();
    let mut observed = ObservedRequest {
        app: &app,
        started: Instant::now(),
        method: request.method().to_string(),
        route: route.map_or("(none)", MatchedPath::as_str).to_owned(),
        name: name.clone(),
        ended: false,
    };
    let head = (request.method(), request.uri(), request.version());
    let verdict = app.guard.check(head, request.headers());
    let mut response = match verdict {
        Err(fault) => fail(fault),
        Ok(Verdict::Enter(cookie)) => enter(&cookie),
        Ok(Verdict::Pass) => {
            let answered = AssertUnwindSafe(next.run(request)).catch_unwind().await;
            answered.unwrap_or_else(|_| {
                app.metrics.add(Scalar::Panics, 1);
                fail(Fault::failed())
            })
        }
    };
    let mut fault = response.extensions_mut().remove::<Fault>();
    // Addresses that cannot be read are refused before they come to us.
    if fault.is_none() && response.status() == StatusCode::BAD_REQUEST {
        fault = Some(Fault::malformed("the address cannot be read"));
    }
    let kind = fault.as_ref().map(|fault| fault.kind);
    if let Some(fault) = fault {
        explain(&mut response, &fault, &name);
    }
    let headers = response.headers_mut();
    headers.extend(
        HeaderValue::try_from(&name)
            .ok()
            .map(|name| (REQUEST, name)),
    );
    let nosniff = HeaderValue::from_static("nosniff");
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, nosniff);
    headers
        .entry(header::CACHE_CONTROL)
        .or_insert(HeaderValue::from_static("no-store"));
    observed.end(response.status().as_u16(), kind);
    response
}

fn fail(fault: Fault) -> Response<Body> {
    axum::response::IntoResponse::into_response(fault)
}

/// Leads to the page without the token in its address, which stays in the history of the browser.
fn enter(cookie: &str) -> Response<Body> {
    let mut response = Response::new(Body::empty());
    *response.status_mut() = StatusCode::SEE_OTHER;
    let headers = response.headers_mut();
    headers.insert(header::LOCATION, HeaderValue::from_static("/"));
    let cookie = HeaderValue::try_from(cookie).ok();
    headers.extend(cookie.map(|cookie| (header::SET_COOKIE, cookie)));
    response
}

/// Writes the fault as the body of the response.
fn explain(response: &mut Response<Body>, fault: &Fault, name: &str) {
    let mut error = json!({ "message": fault.message, "request": name });
    if let Some(hint) = &fault.hint {
        error["hint"] = hint.as_str().into();
    }
    *response = answer::json(fault.kind.status(), &json!({ "error": error }));
    let headers = response.headers_mut();
    if let Some(after) = fault.retry {
        let seconds = HeaderValue::from(after.as_secs().max(1));
        headers.insert(header::RETRY_AFTER, seconds);
    }
    if fault.kind == FaultKind::Unknown {
        headers.insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
    }
}

/// The name that the client gives its request, if it can stand in a log, or one of our own.
fn name(headers: &HeaderMap) -> String {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    let given = header_text(headers, REQUEST);
    let plain = |c: u8| c.is_ascii_alphanumeric() || b"-_.".contains(&c);
    let sound = |name: &&str| (1..=LONGEST).contains(&name.len()) && name.bytes().all(plain);
    given.filter(sound).map_or_else(
        || {
            let number = COUNT.fetch_add(1, Ordering::Relaxed);
            format!("{}-{number}", std::process::id())
        },
        str::to_owned,
    )
}

/// A request that is being answered. It is counted and logged at its end, also if its client goes before.
struct ObservedRequest<'a> {
    app: &'a App,
    started: Instant,
    method: String,
    route: String,
    name: String,
    ended: bool,
}

impl ObservedRequest<'_> {
    fn end(&mut self, status: u16, fault: Option<FaultKind>) {
        self.ended = true;
        let time = self.started.elapsed();
        let what = (&*self.method, &*self.route);
        self.app.metrics.add_request(what, status, time, fault);
        self.log(status, time, fault);
    }

    fn log(&self, status: u16, time: Duration, fault: Option<FaultKind>) {
        let Some(log) = &self.app.config.log else {
            return;
        };
        let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
        log(&LogEntry {
            time: now.map_or(0.0, |now| now.as_secs_f64()),
            request: self.name.clone(),
            method: self.method.clone(),
            route: self.route.clone(),
            status,
            seconds: time.as_secs_f64(),
            fault: fault.map(FaultKind::name),
        });
    }
}

impl Drop for ObservedRequest<'_> {
    fn drop(&mut self) {
        /// Status that other servers log when a client has disconnected.
        const GONE: u16 = 499;
        if !self.ended {
            self.app.metrics.add_gone();
            self.log(GONE, self.started.elapsed(), Some(FaultKind::Gone));
        }
    }
}
