//! Completions: of an image and points at once, and of scenes that are kept.

use crate::answer;
use crate::app::App;
use crate::complete::Completed;
use crate::encode::{Encoded, encode, no_camera};
use crate::fault::Fault;
use crate::forms::Form;
use crate::frame::{Frame, check_points};
use crate::options::Options;
use crate::part::Part;
use crate::points;
use crate::receive::{Receiver, Request};
use crate::scenes::CachedScene;
use crate::task::Task;
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
    let form = request.form;
    let read = move |body: &mut Receiver<'_>| {
        let upload = body.form(&["image", "points", "camera", "options"])?;
        let options = options(&upload)?;
        upload.need("image")?;
        check_points(&upload)?;
        if form == Form::Ply && upload.get("camera").is_none() {
            return Err(no_camera());
        }
        Ok((upload, options))
    };
    let ((upload, options), place) = request.read(read).await?;
    let own = app.clone();
    let work = move |task: &Task| {
        let work = || {
            let (frame, scene, points, read) = {
                let read = || {
                    let frame = Frame::read(&upload, &own.config.limits)?;
                    let points = frame.points(&upload, &options, &own.config.limits)?;
                    let (width, height) = frame.size();
                    points.points.check(width, height)?;
                    Ok((frame, points))
                };
                let ((frame, points), reading) = task.part(Part::Read, read)?;
                let fit = own.completer.fit_config().changed(&options.changes());
                let completer = own.completer.with_fit(fit);
                let network = || Ok(completer.scene(&frame.image()?)?);
                let (scene, _) = task.part(Part::Network, network)?;
                let read = (frame.remarks.clone(), reading);
                (frame, scene, points, read)
            };
            finish(task, &scene, &frame, points, (&options, form), read)
        };
        work().map_err(|fault| upload.named(fault))
    };
    let encoded = app.pool.run(&app.task(), work).await?;
    Ok(answer::of(encoded, place))
}

/// `POST /v1/scenes`.
pub(crate) async fn create(State(app): State<Arc<App>>, headers: HeaderMap, body: Body) -> Answer {
    let request = Request::new(&app, &headers, body).await?;
    let read = |body: &mut Receiver<'_>| {
        let upload = body.form(&["image", "camera"])?;
        upload.need("image")?;
        Ok(upload)
    };
    let (upload, _place) = request.read(read).await?;
    let own = app.clone();
    let work = move |task: &Task| {
        let work = || {
            let read = || Frame::read(&upload, &own.config.limits);
            let (frame, _) = task.part(Part::Read, read)?;
            let network = || Ok(own.completer.scene(&frame.image()?)?);
            let (scene, _) = task.part(Part::Network, network)?;
            Ok(CachedScene { frame, scene })
        };
        work().map_err(|fault| upload.named(fault))
    };
    let kept = app.pool.run(&app.task(), work).await?;
    let mut described = described(&app, &kept);
    let name = app.scenes.keep(kept)?;
    described["id"] = name.clone().into();
    let mut response = answer::json(StatusCode::CREATED, &described);
    let place = format!("/v1/scenes/{name}").try_into();
    let place = place.map_err(|_| Fault::failed())?;
    response.headers_mut().insert(header::LOCATION, place);
    Ok(response)
}

/// `GET /v1/scenes/{id}`.
pub(crate) async fn show(State(app): State<Arc<App>>, Path(name): Path<String>) -> Answer {
    let kept = app.scenes.get(&name)?;
    let mut described = described(&app, &kept);
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

/// The points of a request to a scene, and what they are read with.
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
        let options = options(&upload)?;
        Ok(Self::Form(upload, options))
    }

    fn points(self, frame: &Frame, app: &App) -> Result<(Sparse, Options), Fault> {
        let limits = &app.config.limits;
        match self {
            Self::Json(json) => {
                let (points, options) = points::parse_with_options(&json, limits.points)?;
                Ok((frame.listed(points, &options)?, options))
            }
            Self::Form(upload, options) => {
                let points = frame.points(&upload, &options, limits);
                let points = points.map_err(|fault| upload.named(fault))?;
                Ok((points, options))
            }
        }
    }
}

/// `POST /v1/scenes/{id}/complete`.
pub(crate) async fn again(
    State(app): State<Arc<App>>,
    Path(name): Path<String>,
    headers: HeaderMap,
    body: Body,
) -> Answer {
    let request = Request::new(&app, &headers, body).await?;
    let (form, own) = (request.form, app.clone());
    let read = move |body: &mut Receiver<'_>| {
        let kept = own.scenes.get(&name)?;
        if form == Form::Ply && kept.frame.camera.is_none() {
            return Err(no_camera());
        }
        Ok((kept, RequestBody::read(body)?))
    };
    let ((kept, sent), place) = request.read(read).await?;
    let own = app.clone();
    let work = move |task: &Task| {
        let CachedScene { frame, scene } = &*kept;
        let ((points, options), reading) = task.part(Part::Read, || sent.points(frame, &own))?;
        let fit = own.completer.fit_config().changed(&options.changes());
        let scene = scene.with_fit(fit)?;
        let read = (frame.remarks.clone(), reading);
        finish(task, &scene, frame, points, (&options, form), read)
    };
    let encoded = app.pool.run(&app.task(), work).await?;
    Ok(answer::of(encoded, place))
}

/// The last parts, which both ways share.
fn finish(
    task: &Task,
    scene: &Scene,
    frame: &Frame,
    points: Sparse,
    (options, form): (&Options, Form),
    read: (Vec<String>, Duration),
) -> Result<Encoded, Fault> {
    let found = Completed::new(task, scene, points, (options, form), read)?;
    let (encoded, _) = task.part(Part::Encode, || encode(form, &found, frame, options))?;
    Ok(encoded)
}

fn options(upload: &Upload) -> Result<Options, Fault> {
    match upload.get("options") {
        None => Ok(Options::default()),
        Some(path) => {
            let json = std::fs::read(path).map_err(|_| Fault::failed())?;
            Options::parse(&json)
        }
    }
}

/// A scene, but for its name.
fn described(app: &App, kept: &CachedScene) -> Value {
    let camera = kept.frame.camera.as_ref().map(|camera| {
        let [fx, fy, cx, cy] = camera.intrinsics();
        json!({ "fx": fx, "fy": fy, "cx": cx, "cy": cy })
    });
    json!({
        "width": kept.scene.width(),
        "height": kept.scene.height(),
        "weights": app.config.weights,
        "camera": camera,
        "remarks": kept.frame.remarks,
        "expires_in": app.scenes.expiry().as_secs(),
    })
}
