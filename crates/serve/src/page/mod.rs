//! The page: its files, which are part of the program, and what it asks for beyond the service.

mod assets;
mod demo;
mod gallery;
mod media;
mod results;
mod settings;
mod start;

pub(crate) use gallery::GalleryCache;
pub use settings::{Asset, Demo, Page, Start};

use crate::app::App;
use axum::Router;
use axum::routing::get;
use std::sync::Arc;

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
