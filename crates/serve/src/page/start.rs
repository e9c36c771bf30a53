//! The frame opened on the command line.

use super::media::media;
use super::settings::{Page, Start};
use crate::answer;
use crate::app::App;
use crate::fault::{Fault, FaultKind};
use axum::body::Body;
use axum::extract::{Path, State};
use axum::http::{Response, StatusCode};
use serde_json::json;
use std::path::PathBuf;
use std::sync::Arc;

impl Start {
    /// The file of a part.
    fn get(&self, part: &str) -> Option<&PathBuf> {
        match part {
            "image" => self.image.as_ref(),
            "points" => self.points.as_ref(),
            "camera" => self.camera.as_ref(),
            _ => None,
        }
    }

    /// Address for the page. It ends in the file name, which decides how the file is read.
    fn address(&self, part: &str) -> Option<String> {
        let ending = self.get(part)?.extension()?.to_str()?;
        Some(format!("/v1/start/{part}.{ending}"))
    }
}

/// The page of a service that has one.
pub(super) fn page(app: &App) -> Result<&Page, Fault> {
    app.config.page.as_ref().ok_or_else(Fault::failed)
}

pub(super) async fn start(State(app): State<Arc<App>>) -> Result<Response<Body>, Fault> {
    let page = page(&app)?;
    let start = &page.start;
    let name = start.image.as_ref().and_then(|path| path.file_name());
    let described = json!({
        "image": start.address("image"),
        "name": name.map(|name| name.to_string_lossy()),
        "points": start.address("points"),
        "camera": start.address("camera"),
        "gallery": !page.gallery.is_empty(),
        "weights": app.config.weights,
        "version": env!("CARGO_PKG_VERSION"),
    });
    Ok(answer::json(StatusCode::OK, &described))
}

pub(super) async fn file(
    State(app): State<Arc<App>>,
    Path(file): Path<String>,
) -> Result<Response<Body>, Fault> {
    let part = file.split('.').next().unwrap_or_default();
    let path = page(&app)?.start.get(part).ok_or_else(missing)?;
    // Opened with the program, on this machine, by its user.
    let bytes = std::fs::read(path).map_err(|_| missing())?;
    Ok(answer::text(media(&file), bytes))
}

fn missing() -> Fault {
    Fault::new(
        FaultKind::NotFound,
        "the page was not opened with this file, or it has gone",
    )
}
