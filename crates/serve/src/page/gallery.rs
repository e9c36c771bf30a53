//! The gallery: results that were made before.

use super::media::media;
use super::results::{GalleryFrame, GalleryRun, runs};
use super::start::page;
use crate::answer;
use crate::app::App;
use crate::fault::{Fault, FaultKind};
use axum::body::Body;
use axum::extract::{Path, State};
use axum::http::{Response, StatusCode};
use image::ImageFormat;
use image::imageops::thumbnail;
use lsdc_core::DepthMap;
use lsdc_files::{Contents, encode_npy};
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::io::Cursor;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

/// Width of a small picture.
const SMALL: u32 = 240;
/// Frames of a run whose standard deviations are summed up, for which their maps are read.
const SUMMED: usize = 500;

/// The runs as they were listed last, by whose numbers and names files are found: no folder is read again for a picture.
#[derive(Default)]
pub(crate) struct GalleryCache(Mutex<Option<Arc<Vec<GalleryRun>>>>);

impl GalleryCache {
    /// Reads the folders.
    pub(super) fn renew(&self, folders: &[PathBuf]) -> Arc<Vec<GalleryRun>> {
        let found = Arc::new(folders.iter().flat_map(|folder| runs(folder)).collect());
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(Arc::clone(&found));
        found
    }

    /// The frame read last, or being read.
    pub(super) fn get(&self, folders: &[PathBuf]) -> Arc<Vec<GalleryRun>> {
        let known = self
            .0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone();
        known.unwrap_or_else(|| self.renew(folders))
    }
}

/// Results are few beside what a service computes, and on this machine: read in the thread that serves them, apart.
async fn apart<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, Fault> + Send + 'static,
) -> Result<T, Fault> {
    let done = tokio::task::spawn_blocking(work).await;
    done.unwrap_or_else(|_| Err(Fault::failed()))
}

pub(super) async fn list(State(app): State<Arc<App>>) -> Result<Response<Body>, Fault> {
    let listed = apart(move || Ok(listed(&app.gallery.renew(&page(&app)?.gallery)))).await?;
    Ok(answer::json(StatusCode::OK, &listed))
}

fn listed(runs: &[GalleryRun]) -> Value {
    let runs = runs.iter().enumerate().map(|(number, run)| {
        let summed = run.frames.len() <= SUMMED;
        let frames = run.frames.iter().map(|(id, frame)| {
            let address = |kind: &str, there: bool| {
                there.then(|| format!("/v1/gallery/{number}/{kind}/{}", escaped(id)))
            };
            let pictured = frame.colours.is_some() || frame.depth.is_some();
            let deviation = frame.deviation.as_ref().filter(|_| summed);
            json!({
                "id": id,
                "image": address("image", frame.image.is_some()),
                "thumbnail": address("thumbnail", pictured),
                "depth": address("depth", frame.depth.is_some()),
                "deviation": address("deviation", frame.deviation.is_some()),
                "points": null,
                "error": frame.error.map(|(error, _)| error),
                "error_kind": frame.error.map(|(_, kind)| kind),
                "standard_deviation": deviation.and_then(|path| median(&map(path).ok()?)),
                "failure": frame.failure,
            })
        });
        json!({ "name": run.name, "frames": frames.collect::<Value>() })
    });
    json!({ "runs": runs.collect::<Value>() })
}

/// The files of a frame. Only names that the list has lead to files: nothing is made of what is asked for.
pub(super) async fn file(
    State(app): State<Arc<App>>,
    Path((run, kind, id)): Path<(usize, String, String)>,
) -> Result<Response<Body>, Fault> {
    let work = move || {
        let page = page(&app)?;
        let missing = || Fault::new(FaultKind::NotFound, "the gallery has no such file");
        let runs = app.gallery.get(&page.gallery);
        let run = runs.get(run).ok_or_else(missing)?;
        let frame = run.frames.get(&id).ok_or_else(missing)?;
        let needed = |path: &Option<PathBuf>| path.clone().ok_or_else(missing);
        match kind.as_str() {
            "image" => whole(needed(&frame.image)?),
            "depth" => npy(needed(&frame.depth)?),
            "deviation" => npy(needed(&frame.deviation)?),
            "thumbnail" => small(frame, page.paint),
            _ => Err(missing()),
        }
    };
    apart(work).await
}

fn whole(path: PathBuf) -> Result<Response<Body>, Fault> {
    let bytes = std::fs::read(&path).map_err(|_| Fault::failed())?;
    Ok(answer::text(media(&path.to_string_lossy()), bytes))
}

fn npy(path: PathBuf) -> Result<Response<Body>, Fault> {
    Ok(answer::text(media("map.npy"), encode_npy(&map(&path)?)?))
}

fn map(path: &std::path::Path) -> Result<DepthMap, Fault> {
    let contents = Contents::read(path, None)?;
    let map = contents.map().cloned();
    map.ok_or_else(|| Fault::unusable("the file holds no map"))
}

fn small(
    frame: &GalleryFrame,
    paint: fn(&DepthMap) -> image::RgbImage,
) -> Result<Response<Body>, Fault> {
    let picture = match (&frame.colours, &frame.depth) {
        (Some(path), _) => lsdc_files::read_rgb(path)?,
        (None, Some(path)) => paint(&map(path)?),
        (None, None) => return Err(Fault::new(FaultKind::NotFound, "the frame has no picture")),
    };
    let (width, height) = picture.dimensions();
    let across = width.min(SMALL);
    let down = (u64::from(height) * u64::from(across) / u64::from(width.max(1))).max(1);
    let small = thumbnail(&picture, across, down as u32);
    let mut bytes = Cursor::new(Vec::new());
    let written = small.write_to(&mut bytes, ImageFormat::Png);
    written.map_err(|_| Fault::failed())?;
    Ok(answer::text(media("small.png"), bytes.into_inner()))
}

/// The median of what is in a map.
fn median(map: &DepthMap) -> Option<f32> {
    let mut values: Vec<f32> = map.points().map(|point| point.depth).collect();
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    Some(*values.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// A name in an address (RFC 3986, section 2).
fn escaped(name: &str) -> String {
    let mut text = String::new();
    for byte in name.bytes() {
        if byte.is_ascii_alphanumeric() || b"-_.~/".contains(&byte) {
            text.push(byte.into());
        } else {
            // Writing to a string does not fail.
            let _ = write!(text, "%{byte:02X}");
        }
    }
    text
}
