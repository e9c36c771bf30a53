//! Scenes that the service keeps for a while.

use crate::client::{Running, asset, file, text};
use lsdc_serve::{Config, Limits};
use std::time::Duration;

fn create(service: &Running) -> String {
    let rgb = asset("rgb.png");
    let reply = service.post("/v1/scenes", "*/*", &[file("image", "rgb.png", &rgb)]);
    assert_eq!(reply.status, 201, "{reply:?}");
    reply.header("location").unwrap().to_owned()
}

#[test]
fn a_scene_is_shown_completed_and_forgotten() {
    let service = Running::new(Config {
        weights: "small".to_owned(),
        ..Config::default()
    });
    let rgb = asset("rgb.png");
    let camera = "fx = 200\nfy = 210\ncx = 150\ncy = 110\nwidth = 304\nheight = 228\n";
    let parts = [
        file("image", "a.png", &rgb),
        file("camera", "camera.toml", camera.as_bytes()),
    ];
    let posted = service.post("/v1/scenes", "*/*", &parts).json();
    assert_eq!(
        (&posted["width"], &posted["height"]),
        (&304.into(), &228.into())
    );
    assert_eq!(
        (&posted["camera"]["fy"], &posted["camera"]["cx"]),
        (&210.0.into(), &150.0.into())
    );
    assert_eq!(posted["weights"], "small");
    let path = format!("/v1/scenes/{}", posted["id"].as_str().unwrap());
    assert_eq!(service.get(&path).json(), posted);
    assert_eq!(service.metric("lsdc_scenes"), Some(1.0));
    assert_eq!(service.ask("DELETE", &path, &[], &[]).status, 204);
    assert_eq!(service.get(&path).status, 404);
    assert_eq!(service.ask("DELETE", &path, &[], &[]).status, 404);
    let completed = service.post(&(path + "/complete"), "*/*", &[text("points", "[[1,1,1]]")]);
    assert_eq!(completed.status, 404);
    assert_eq!(service.metric("lsdc_scene_bytes"), Some(0.0));
}

#[test]
fn the_least_recently_used_makes_room() {
    let service = Running::new(Config::default());
    create(&service);
    let bytes = service.metric("lsdc_scene_bytes").unwrap() as u64;
    let service = Running::new(Config {
        limits: Limits {
            scenes: 2 * bytes,
            ..Limits::default()
        },
        ..Config::default()
    });
    let (first, second) = (create(&service), create(&service));
    assert_eq!(service.get(&first).status, 200);
    let third = create(&service);
    let left = [&first, &second, &third].map(|path| service.get(path).status);
    assert_eq!(left, [200, 404, 200]);

    let service = Running::new(Config {
        limits: Limits {
            scenes: bytes - 1,
            ..Limits::default()
        },
        ..Config::default()
    });
    let rgb = asset("rgb.png");
    let reply = service.post("/v1/scenes", "*/*", &[file("image", "rgb.png", &rgb)]);
    assert_eq!(reply.status, 413);
}

#[test]
fn an_unused_scene_expires() {
    let service = Running::new(Config {
        limits: Limits {
            expiry: Duration::ZERO,
            ..Limits::default()
        },
        ..Config::default()
    });
    let path = create(&service);
    assert_eq!(service.get(&path).status, 404);
    assert_eq!(service.metric("lsdc_scenes"), Some(0.0));
}
