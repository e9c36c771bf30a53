//! Images to try.

use super::media::media;
use super::start::page;
use crate::answer;
use crate::app::App;
use crate::fault::{Fault, FaultKind};
use axum::body::Body;
use axum::extract::{Path, State};
use axum::http::{Response, StatusCode};
use serde_json::{Value, json};
use std::sync::Arc;

pub(super) async fn list(State(app): State<Arc<App>>) -> Result<Response<Body>, Fault> {
    let demos = page(&app)?.demos.iter().map(|demo| {
        let address = |file: &str| format!("/v1/demo/{}/{file}", demo.name);
        json!({
            "name": demo.name,
            "title": demo.title,
            "image": address(demo.image.name),
            "points": address(demo.points.name),
        })
    });
    Ok(answer::json(StatusCode::OK, &demos.collect::<Value>()))
}

pub(super) async fn file(
    State(app): State<Arc<App>>,
    Path((name, file)): Path<(String, String)>,
) -> Result<Response<Body>, Fault> {
    let demos = page(&app)?.demos.iter().filter(|demo| demo.name == name);
    let mut files = demos.flat_map(|demo| [demo.image, demo.points]);
    let found = files.find(|asset| asset.name == file);
    let found = found.ok_or_else(|| Fault::new(FaultKind::NotFound, "there is no such example"))?;
    Ok(answer::text(media(found.name), found.bytes))
}
