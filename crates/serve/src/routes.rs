//! All routes of the service.

use crate::app::App;
use crate::fault::{Fault, FaultKind};
use crate::observe::observe;
use crate::{answer, api, page};
use axum::Router;
use axum::body::Body;
use axum::extract::State;
use axum::http::{Response, StatusCode};
use axum::middleware::from_fn_with_state;
use axum::routing::{MethodRouter, get, post};
use serde_json::json;
use std::sync::Arc;

/// The description of the service, `OpenAPI` 3.1.
const DESCRIPTION: &str = include_str!("../openapi.json");

/// An address, its methods, and what answers them.
type Route = (
    &'static str,
    &'static [&'static str],
    MethodRouter<Arc<App>>,
);

/// The addresses of the service itself, as its description lists them.
pub(crate) fn routes() -> Vec<Route> {
    vec![
        ("/v1/complete", &["post"], post(api::complete)),
        ("/v1/scenes", &["post"], post(api::create)),
        (
            "/v1/scenes/{id}",
            &["get", "delete"],
            get(api::show).delete(api::forget),
        ),
        (
            "/v1/scenes/{id}/complete",
            &["post"],
            post(api::complete_scene),
        ),
        ("/healthz", &["get"], get(healthy)),
        ("/readyz", &["get"], get(ready)),
        ("/metrics", &["get"], get(metrics)),
        ("/openapi.json", &["get"], get(description)),
    ]
}

/// The whole service.
pub(crate) fn router(app: &Arc<App>) -> Router {
    let mut router = Router::new();
    for (path, _, answers) in routes() {
        router = router.route(path, answers);
    }
    if app.config.page.is_some() {
        router = page::routes(router);
    }
    router
        .fallback(async || Fault::new(FaultKind::NotFound, "there is nothing at this address"))
        .method_not_allowed_fallback(async || {
            Fault::new(
                FaultKind::Method,
                "this address does not answer this method",
            )
        })
        .layer(from_fn_with_state(app.clone(), observe))
        .with_state(app.clone())
}

/// The service runs.
async fn healthy() -> Response<Body> {
    answer::json(StatusCode::OK, &json!({ "status": "ok" }))
}

/// It takes requests.
async fn ready(State(app): State<Arc<App>>) -> Result<Response<Body>, Fault> {
    if !app.is_ready() {
        return Err(Fault::new(FaultKind::Gone, "the service is about to end"));
    }
    Ok(answer::json(StatusCode::OK, &json!({ "status": "ready" })))
}

async fn metrics(State(app): State<Arc<App>>) -> Response<Body> {
    answer::text("text/plain; version=0.0.4", app.metrics.text())
}

async fn description() -> Response<Body> {
    answer::text("application/json", DESCRIPTION)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn the_description_has_every_route_and_no_other() {
        let description: serde_json::Value = serde_json::from_str(DESCRIPTION).unwrap();
        let paths = description["paths"].as_object().unwrap();
        let methods = ["get", "post", "put", "patch", "delete"];
        let described: BTreeSet<(String, String)> = paths
            .iter()
            .flat_map(|(path, item)| {
                let keys = item.as_object().unwrap().keys();
                let keys = keys.filter(|key| methods.contains(&key.as_str()));
                keys.map(|method| (path.clone(), method.clone()))
            })
            .collect();
        let answered: BTreeSet<(String, String)> = routes()
            .iter()
            .flat_map(|(path, methods, _)| {
                let path = (*path).to_owned();
                methods.iter().map(move |m| (path.clone(), (*m).to_owned()))
            })
            .collect();
        assert_eq!(described, answered);
        assert_eq!(description["info"]["version"], env!("CARGO_PKG_VERSION"));
    }
}
