//! Completions: of an image and points at once, and of scenes that are kept.

use crate::answer;
use crate::app::App;
use crate::body::Incoming;
use crate::complete::Completed;
use crate::encode::{Encoded, Form, encode, no_camera};
use crate::fault::{Fault, Kind};
use crate::frame::{Frame, check_points};
use crate::options::Options;
use crate::points::Points;
use crate::scenes::Kept;
use crate::task::{Part, Task};
use crate::upload::Upload;
use axum::body::Body;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, Response, StatusCode, header};
use lsdc_core::Scene;
use lsdc_files::Sparse;
use serde::Deserialize;
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
    let (form, options, upload) = {
        let mut body = Incoming::new(body, &app.config.limits);
        let read = async {
            let form = begun(&app, &headers, &body)?;
            let known = ["image", "points", "camera", "options"];
            let upload = Upload::read(content_type(&headers), &mut body, &known).await?;
            let options = options(&upload)?;
            upload.need("image")?;
            check_points(&upload)?;
            if form == Form::Ply && upload.get("camera").is_none() {
                return Err(no_camera());
            }
            Ok((form, options, upload))
        };
        match read.await {
            Ok(read) => read,
            Err(fault) => return Err(refused(&mut body, fault).await),
        }
    };
    let place = app.crew.place()?;
    let own = app.clone();
    let work = move |task: &Task| {
        let work = || {
            let (frame, scene, points, read) = {
                let read = || {
                    let frame = Frame::read(&upload, &own.config.limits)?;
                    let points = frame.points(&upload, &options, &own.config.limits)?;
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
    let encoded = app.crew.run(&app.task(), work).await?;
    Ok(answer::of(encoded, place))
}

/// `POST /v1/scenes`.
pub(crate) async fn create(State(app): State<Arc<App>>, headers: HeaderMap, body: Body) -> Answer {
    let mut body = Incoming::new(body, &app.config.limits);
    let read = async {
        begun(&app, &headers, &body)?;
        let upload = Upload::read(content_type(&headers), &mut body, &["image", "camera"]).await?;
        upload.need("image")?;
        Ok(upload)
    };
    let upload = match read.await {
        Ok(upload) => upload,
        Err(fault) => return Err(refused(&mut body, fault).await),
    };
    let _place = app.crew.place()?;
    let own = app.clone();
    let work = move |task: &Task| {
        let work = || {
            let read = || Frame::read(&upload, &own.config.limits);
            let (frame, _) = task.part(Part::Read, read)?;
            let network = || Ok(own.completer.scene(&frame.image()?)?);
            let (scene, _) = task.part(Part::Network, network)?;
            Ok(Kept { frame, scene })
        };
        work().map_err(|fault| upload.named(fault))
    };
    let kept = app.crew.run(&app.task(), work).await?;
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

/// What `POST /v1/scenes/{id}/complete` takes as JSON.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Ask {
    points: Points,
    #[serde(default)]
    options: Options,
}

/// The points of a request to a scene, and what they are read with.
enum Sent {
    List(Points),
    Form(Upload),
}

/// `POST /v1/scenes/{id}/complete`.
pub(crate) async fn again(
    State(app): State<Arc<App>>,
    Path(name): Path<String>,
    headers: HeaderMap,
    body: Body,
) -> Answer {
    let mut body = Incoming::new(body, &app.config.limits);
    let read = async {
        let form = begun(&app, &headers, &body)?;
        let kept = app.scenes.get(&name)?;
        if form == Form::Ply && kept.frame.camera.is_none() {
            return Err(no_camera());
        }
        let (sent, options) = sent(&app, content_type(&headers), &mut body).await?;
        Ok((form, kept, sent, options))
    };
    let (form, kept, sent, options) = match read.await {
        Ok(read) => read,
        Err(fault) => return Err(refused(&mut body, fault).await),
    };
    let place = app.crew.place()?;
    let own = app.clone();
    let work = move |task: &Task| {
        let Kept { frame, scene } = &*kept;
        let read = || match &sent {
            Sent::List(points) => frame.listed(points.clone(), &options),
            Sent::Form(upload) => frame
                .points(upload, &options, &own.config.limits)
                .map_err(|fault| upload.named(fault)),
        };
        let (points, reading) = task.part(Part::Read, read)?;
        let fit = own.completer.fit_config().changed(&options.changes());
        let scene = scene.with_fit(fit)?;
        let read = (frame.remarks.clone(), reading);
        finish(task, &scene, frame, points, (&options, form), read)
    };
    let encoded = app.crew.run(&app.task(), work).await?;
    Ok(answer::of(encoded, place))
}

async fn sent(
    app: &App,
    content_type: &str,
    body: &mut Incoming,
) -> Result<(Sent, Options), Fault> {
    let essence = content_type.split(';').next().unwrap_or_default().trim();
    if !essence.eq_ignore_ascii_case("application/json") {
        let upload = Upload::read(content_type, body, &["points", "options"]).await?;
        check_points(&upload)?;
        let options = options(&upload)?;
        return Ok((Sent::Form(upload), options));
    }
    let ask: Ask = serde_json::from_slice(&body.whole().await?).map_err(|e| {
        Fault::malformed(format!("the request cannot be read: {e}"))
            .hint("it is {\"points\": [[u, v, depth], ...], \"options\": {...}}")
    })?;
    let points = ask.points.checked(app.config.limits.points)?;
    Ok((Sent::List(points), ask.options.checked()?))
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

/// Checks what the head of a request says before its body is read.
fn begun(app: &App, headers: &HeaderMap, body: &Incoming) -> Result<Form, Fault> {
    let accept = headers.get(header::ACCEPT);
    let accept = accept.map(|value| value.to_str().unwrap_or_default());
    let form = Form::accepted(accept)?;
    let length = headers.get(header::CONTENT_LENGTH);
    body.check(length.and_then(|value| value.to_str().ok()?.parse().ok()))?;
    app.crew.check()?;
    Ok(form)
}

/// A request that is refused, whose body is read to its end so that its client hears of it.
async fn refused(body: &mut Incoming, fault: Fault) -> Fault {
    if fault.kind != Kind::Slow {
        body.linger().await;
    }
    fault
}

fn content_type(headers: &HeaderMap) -> &str {
    let value = headers.get(header::CONTENT_TYPE);
    value
        .and_then(|value| value.to_str().ok())
        .unwrap_or_default()
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
fn described(app: &App, kept: &Kept) -> Value {
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
