//! Completions: of an image and points at once, and of scenes that are kept.

use crate::answer;
use crate::app::App;
use crate::complete::CompletionResult;
use crate::computation::{Computation, Stage};
use crate::encode::{EncodedAnswer, encode, no_camera};
use crate::fault::Fault;
use crate::frame::{InputFrame, check_points};
use crate::media_type::MediaType;
use crate::options::Options;
use crate::points;
use crate::receive::{Receiver, Request};
use crate::scene_cache::CachedScene;
use crate::upload::Upload;
use axum::body::Body;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, Response, StatusCode, header};
use lsdc_core::Scene;
use lsdc_files::Sparse;
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::Duration;

type Answer = Result<Response<Body>, Fault>;

/// `POST /v1/complete`.
pub(crate) async fn complete(
    State(app): State<Arc<App>>,
    headers: HeaderMap,
    body: Body,
) -> Answer {
    let request = Request::new(&app, &headers, body).await?;
    let media_type = request.media_type;
    let read = move |body: &mut Receiver<'_>| {
        let upload = body.form(&["image", "points", "camera", "options"])?;
        let options = Options::read(&upload)?;
        upload.need("image")?;
        check_points(&upload)?;
        if media_type == MediaType::Ply && upload.get("camera").is_none() {
            return Err(no_camera());
        }
        Ok((upload, options))
    };
    let ((upload, options), slot) = request.read(read).await?;
    let state = app.clone();
    let work = move |computation: &Computation| {
        upload.with_client_names(|| {
            let read = || {
                let limits = &state.config.limits;
                let frame = InputFrame::read(&upload, limits)?;
                let points = frame.points(&upload, &options, limits)?;
                let (width, height) = frame.size();
                points.points.check(width, height)?;
                Ok((frame, points))
            };
            let ((frame, points), reading) = computation.stage(Stage::Read, read)?;
            let fit = state.completer.fit_config().changed(&options.changes());
            let completer = state.completer.with_fit(fit);
            let network = || Ok(completer.scene(&frame.image()?)?);
            let (scene, _) = computation.stage(Stage::Network, network)?;
            let answer = (&options, media_type);
            finish(computation, &scene, &frame, (points, reading), answer)
        })
    };
    let encoded = app.run(work).await?;
    Ok(answer::of(encoded, slot))
}

/// `POST /v1/scenes`.
pub(crate) async fn create(State(app): State<Arc<App>>, headers: HeaderMap, body: Body) -> Answer {
    let request = Request::new(&app, &headers, body).await?;
    let read = |body: &mut Receiver<'_>| {
        let upload = body.form(&["image", "camera"])?;
        upload.need("image")?;
        Ok(upload)
    };
    let (upload, _slot) = request.read(read).await?;
    let state = app.clone();
    let work = move |computation: &Computation| {
        upload.with_client_names(|| {
            let read = || InputFrame::read(&upload, &state.config.limits);
            let (frame, _) = computation.stage(Stage::Read, read)?;
            let network = || Ok(state.completer.scene(&frame.image()?)?);
            let (scene, _) = computation.stage(Stage::Network, network)?;
            Ok(CachedScene { frame, scene })
        })
    };
    let scene = app.run(work).await?;
    let mut described = described(&app, &scene);
    let name = app.scenes.keep(scene)?;
    described["id"] = name.clone().into();
    let mut response = answer::json(StatusCode::CREATED, &described);
    let location = format!("/v1/scenes/{name}").try_into();
    let location = location.map_err(|_| Fault::failed())?;
    response.headers_mut().insert(header::LOCATION, location);
    Ok(response)
}

/// `GET /v1/scenes/{id}`.
pub(crate) async fn show(State(app): State<Arc<App>>, Path(name): Path<String>) -> Answer {
    let scene = app.scenes.get(&name)?;
    let mut described = described(&app, &scene);
    described["id"] = name.into();
    Ok(answer::json(StatusCode::OK, &described))
}

/// `DELETE /v1/scenes/{id}`.
pub(crate) async fn forget(State(app): State<Arc<App>>, Path(name): Path<String>) -> Answer {
    app.scenes.remove(&name)?;
    let mut response = Response::new(Body::empty());
    *response.status_mut() = StatusCode::NO_CONTENT;
    Ok(response)
}

/// The points of a request to a scene, and the options to read them with.
enum RequestBody {
    /// Points and options, to be parsed by the thread that computes.
    Json(Vec<u8>),
    Form(Upload, Options),
}

impl RequestBody {
    fn read(body: &mut Receiver<'_>) -> Result<Self, Fault> {
        if body.is_json() {
            return Ok(Self::Json(body.whole()?));
        }
        let upload = body.form(&["points", "options"])?;
        check_points(&upload)?;
        let options = Options::read(&upload)?;
        Ok(Self::Form(upload, options))
    }

    fn points(self, frame: &InputFrame, app: &App) -> Result<(Sparse, Options), Fault> {
        let limits = &app.config.limits;
        match self {
            Self::Json(json) => {
                let (points, options) = points::parse_with_options(&json, limits.points)?;
                Ok((frame.listed_points(points, &options)?, options))
            }
            Self::Form(upload, options) => {
                let points = || frame.points(&upload, &options, limits);
                Ok((upload.with_client_names(points)?, options))
            }
        }
    }
}

/// `POST /v1/scenes/{id}/complete`.
pub(crate) async fn complete_scene(
    State(app): State<Arc<App>>,
    Path(name): Path<String>,
    headers: HeaderMap,
    body: Body,
) -> Answer {
    let request = Request::new(&app, &headers, body).await?;
    let (media_type, state) = (request.media_type, app.clone());
    let read = move |body: &mut Receiver<'_>| {
        let scene = state.scenes.get(&name)?;
        if media_type == MediaType::Ply && scene.frame.camera.is_none() {
            return Err(no_camera());
        }
        Ok((scene, RequestBody::read(body)?))
    };
    let ((cached, body), slot) = request.read(read).await?;
    let state = app.clone();
    let work = move |computation: &Computation| {
        let CachedScene { frame, scene } = &*cached;
        let read = || body.points(frame, &state);
        let ((points, options), reading) = computation.stage(Stage::Read, read)?;
        let fit = state.completer.fit_config().changed(&options.changes());
        let scene = scene.with_fit(fit)?;
        let answer = (&options, media_type);
        finish(computation, &scene, frame, (points, reading), answer)
    };
    let encoded = app.run(work).await?;
    Ok(answer::of(encoded, slot))
}

/// The stages after the network.
fn finish(
    computation: &Computation,
    scene: &Scene,
    frame: &InputFrame,
    (points, reading): (Sparse, Duration),
    (options, media_type): (&Options, MediaType),
) -> Result<EncodedAnswer, Fault> {
    let read = (frame.remarks.clone(), reading);
    let found = CompletionResult::new(computation, scene, points, (options, media_type), read)?;
    let encode = || encode(media_type, &found, frame, options);
    let (encoded, _) = computation.stage(Stage::Encode, encode)?;
    Ok(encoded)
}

/// A scene without its name.
fn described(app: &App, cached: &CachedScene) -> Value {
    let camera = cached.frame.camera.as_ref().map(|camera| {
        let [fx, fy, cx, cy] = camera.intrinsics();
        json!({ "fx": fx, "fy": fy, "cx": cx, "cy": cy })
    });
    json!({
        "width": cached.scene.width(),
        "height": cached.scene.height(),
        "weights": app.config.weights,
        "camera": camera,
        "remarks": cached.frame.remarks,
        "expires_in": app.scenes.expiry().as_secs(),
    })
}
