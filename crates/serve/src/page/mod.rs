//! The page: its files, which are part of the program, and what it asks for beyond the service.

mod assets;
mod demo;
mod gallery;
mod results;
mod start;

pub(crate) use gallery::Index;

use crate::app::App;
use axum::Router;
use axum::routing::get;
use image::RgbImage;
use lsdc_core::DepthMap;
use std::path::PathBuf;
use std::sync::Arc;

/// What the page shows.
#[derive(Clone)]
pub struct Page {
    /// What it opens with.
    pub start: Start,
    /// Images to try.
    pub demos: Vec<Demo>,
    /// Folders of results.
    pub gallery: Vec<PathBuf>,
    /// Colours of a depth map, for small pictures.
    pub paint: fn(&DepthMap) -> RgbImage,
}

/// Files that the page opens with.
#[derive(Clone, Debug, Default)]
pub struct Start {
    /// The image.
    pub image: Option<PathBuf>,
    /// Points in it, in any file that is read.
    pub points: Option<PathBuf>,
    /// Its camera.
    pub camera: Option<PathBuf>,
}

/// An image to try, with points.
#[derive(Clone, Debug)]
pub struct Demo {
    /// In addresses: letters and digits.
    pub name: &'static str,
    /// For people.
    pub title: &'static str,
    /// The image.
    pub image: Asset,
    /// The points.
    pub points: Asset,
}

/// A file that is part of the program.
#[derive(Clone, Copy, Debug)]
pub struct Asset {
    /// Its name, whose ending says what it is.
    pub name: &'static str,
    /// What is in it.
    pub bytes: &'static [u8],
}

/// Adds the addresses of the page.
pub(crate) fn routes(router: Router<Arc<App>>) -> Router<Arc<App>> {
    router
        .route("/", get(assets::index))
        .route("/{*file}", get(assets::file))
        .route("/v1/start", get(start::start))
        .route("/v1/start/{file}", get(start::file))
        .route("/v1/demo", get(demo::list))
        .route("/v1/demo/{name}/{file}", get(demo::file))
        .route("/v1/gallery", get(gallery::list))
        .route("/v1/gallery/{run}/{kind}/{*frame}", get(gallery::file))
}

/// The media type of a file, by the ending of its name.
fn media(name: &str) -> &'static str {
    let ending = name.rsplit('.').next().unwrap_or_default();
    match ending.to_ascii_lowercase().as_str() {
        "html" => "text/html; charset=utf-8",
        "js" | "mjs" => "text/javascript; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "svg" => "image/svg+xml",
        "json" | "map" => "application/json",
        "png" => "image/png",
        "jpg" | "jpeg" => "image/jpeg",
        "webp" => "image/webp",
        "bmp" => "image/bmp",
        "tif" | "tiff" => "image/tiff",
        "woff2" => "font/woff2",
        "wasm" => "application/wasm",
        "npy" => "application/x-npy",
        "npz" => "application/x-npz",
        "txt" | "csv" | "toml" | "yaml" | "yml" => "text/plain; charset=utf-8",
        _ => "application/octet-stream",
    }
}
