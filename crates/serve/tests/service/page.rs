//! The page and its requests.

use crate::client::{Running, asset_path};
use lsdc_files::{DepthMap, write_depth_png, write_npy};
use lsdc_serve::{Access, Asset, Config, Demo, Page, Start};
use std::path::{Path, PathBuf};

const TOKEN: &str = "0123456789abcdef0123";

fn paint(depth: &DepthMap) -> image::RgbImage {
    image::RgbImage::new(depth.width() as u32, depth.height() as u32)
}

fn page(gallery: Vec<PathBuf>) -> Running {
    Running::new(Config {
        access: Access {
            token: Some(TOKEN.to_owned()),
            open: false,
        },
        page: Some(Page {
            start: Start {
                image: Some(asset_path("rgb.png")),
                points: Some(asset_path("sparse.npy")),
                camera: None,
            },
            demos: vec![Demo {
                name: "room",
                title: "A room",
                image: Asset {
                    name: "rgb.png",
                    bytes: b"image",
                },
                points: Asset {
                    name: "sparse.npy",
                    bytes: b"points",
                },
            }],
            gallery,
            paint,
        }),
        ..Config::default()
    })
}

fn get(service: &Running, path: &str) -> crate::client::Reply {
    let cookie = format!("lsdc-{}={TOKEN}", service.address.port());
    service.ask("GET", path, &[("cookie", &cookie)], &[])
}

#[test]
fn the_link_opens_the_page_and_nothing_else_does() {
    let service = page(vec![]);
    assert_eq!(service.get("/").status, 401);
    assert_eq!(service.get("/index.html").status, 401);
    assert_eq!(service.get("/?token=guess").status, 401);
    let entered = service.get(&format!("/?token={TOKEN}"));
    assert_eq!(
        (entered.status, entered.header("location")),
        (303, Some("/"))
    );
    let cookie = entered.header("set-cookie").unwrap();
    assert!(
        cookie.contains("HttpOnly") && cookie.contains("SameSite=Strict"),
        "{cookie}"
    );
    let shown = cookie.split(';').next().unwrap();
    let index = service.ask("GET", "/", &[("cookie", shown)], &[]);
    assert_eq!(index.status, 200);
    assert_eq!(
        index.header("content-type"),
        Some("text/html; charset=utf-8")
    );
    let policy = index.header("content-security-policy").unwrap();
    assert!(
        policy.contains("default-src 'none'") && !policy.contains("unsafe"),
        "{policy}"
    );
    // An unchanged file is not sent again.
    let tag = index.header("etag").unwrap();
    let headers = [("cookie", shown), ("if-none-match", tag)];
    let again = service.ask("GET", "/index.html", &headers, &[]);
    assert_eq!((again.status, again.body.len()), (304, 0));
    for (name, value) in [("host", "evil.example"), ("origin", "http://evil.example")] {
        let headers = [("cookie", shown), (name, value)];
        assert_eq!(service.ask("GET", "/", &headers, &[]).status, 403);
    }
    assert_eq!(get(&service, "/../Cargo.toml").status, 404);
    assert_eq!(get(&service, "/%2e%2e/Cargo.toml").status, 404);
}

#[test]
fn the_page_finds_what_the_command_line_has_opened() {
    let service = page(vec![]);
    let start = get(&service, "/v1/start").json();
    assert_eq!(start["name"], "rgb.png");
    assert_eq!(start["gallery"], false);
    assert_eq!(start["camera"], serde_json::Value::Null);
    for (part, name) in [("image", "rgb.png"), ("points", "sparse.npy")] {
        let reply = get(&service, start[part].as_str().unwrap());
        assert_eq!(reply.body, std::fs::read(asset_path(name)).unwrap());
    }
    assert_eq!(get(&service, "/v1/start/camera.toml").status, 404);
    assert_eq!(get(&service, "/v1/start/passwd").status, 404);
    let demos = get(&service, "/v1/demo").json();
    assert_eq!(demos[0]["title"], "A room");
    let image = get(&service, demos[0]["image"].as_str().unwrap());
    assert_eq!(
        (image.body.as_slice(), image.header("content-type")),
        (&b"image"[..], Some("image/png"))
    );
}

fn map(value: f32) -> DepthMap {
    DepthMap::new(6, 4, vec![value; 24]).unwrap()
}

fn write(folder: &Path, name: &str, text: &str) {
    let path = folder.join(name);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, text).unwrap();
}

#[test]
fn results_of_a_completion_are_a_gallery() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir_all(at("left")).unwrap();
    write_npy(&at("left/a b_depth.npy"), &map(2.0)).unwrap();
    write_npy(&at("left/a b_sigma.npy"), &map(0.25)).unwrap();
    write_depth_png(&at("c_depth.png"), &map(3.0), 0.001).unwrap();
    std::fs::copy(asset_path("rgb.png"), at("c.png")).unwrap();
    let record = "{\"report\": {\"fit\": {\"leave_one_out\": 0.5}}}";
    write(folder.path(), ".lsdc/left/a b.jpg.json", record);
    write(folder.path(), ".lsdc/gone.jpg.json", record);
    let service = page(vec![folder.path().to_owned()]);
    let listed = get(&service, "/v1/gallery").json();
    let frames = listed["runs"][0]["frames"].as_array().unwrap();
    let ids: Vec<&str> = frames
        .iter()
        .map(|frame| frame["id"].as_str().unwrap())
        .collect();
    assert_eq!(ids, ["c", "gone", "left/a b"]);
    assert_eq!(frames[2]["error"], 0.5);
    assert_eq!(frames[2]["error_kind"], "leave-one-out");
    assert_eq!(frames[2]["standard_deviation"], 0.25);
    assert!(frames[1]["failure"].is_string() && frames[1]["depth"].is_null());
    let address = |frame: usize, kind: &str| frames[frame][kind].as_str().unwrap().to_owned();
    let depth = get(&service, &address(2, "depth"));
    assert_eq!(depth.body, lsdc_files::encode_npy(&map(2.0)).unwrap());
    // The page gets metres, whatever the format of the file.
    let depth = get(&service, &address(0, "depth"));
    assert_eq!(depth.body, lsdc_files::encode_npy(&map(3.0)).unwrap());
    let image = get(&service, &address(0, "image"));
    assert_eq!(image.body, std::fs::read(asset_path("rgb.png")).unwrap());
    let small = get(&service, &address(0, "thumbnail"));
    assert_eq!(image::load_from_memory(&small.body).unwrap().width(), 6);
    for path in [
        "0/depth/nothing",
        "1/depth/c",
        "0/secrets/c",
        "0/image/..%2f..%2fetc%2fpasswd",
    ] {
        assert_eq!(
            get(&service, &format!("/v1/gallery/{path}")).status,
            404,
            "{path}"
        );
    }
}

#[test]
fn pictures_are_found_without_reading_the_folders_again() {
    let folder = tempfile::tempdir().unwrap();
    let add = |name: &str| write_npy(&folder.path().join(name), &map(2.0)).unwrap();
    add("a_depth.npy");
    let service = page(vec![folder.path().to_owned()]);
    let status = |frame: &str| get(&service, &format!("/v1/gallery/0/thumbnail/{frame}")).status;
    assert_eq!(status("a"), 200);
    // A later file is found once the list has been read again.
    add("b_depth.npy");
    assert_eq!([status("a"), status("b")], [200, 404]);
    let listed = get(&service, "/v1/gallery").json();
    assert_eq!(listed["runs"][0]["frames"].as_array().unwrap().len(), 2);
    assert_eq!([status("a"), status("b")], [200, 200]);
}

#[test]
fn saved_predictions_of_an_evaluation_are_runs() {
    let folder = tempfile::tempdir().unwrap();
    for (method, depth) in [("lsdc", 2.0), ("linear", 3.0)] {
        let below = folder.path().join(method).join("seed0/kitchen");
        std::fs::create_dir_all(&below).unwrap();
        write_npy(&below.join("1.npy"), &map(depth)).unwrap();
    }
    let report = r#"{"frames": [{"frame": "kitchen/1", "seed": 0, "scores":
        {"lsdc": {"rmse": 0.1}, "linear": {"rmse": 0.2}}}],
        "failures": [{"frame": "kitchen/2", "error": "it has no depth"}]}"#;
    write(folder.path(), "report.json", report);
    let service = page(vec![folder.path().to_owned()]);
    let runs = get(&service, "/v1/gallery").json()["runs"].clone();
    assert_eq!(
        (&runs[0]["name"], &runs[1]["name"]),
        (&"linear".into(), &"lsdc".into())
    );
    let errors = [0, 1].map(|run| {
        let frames = runs[run]["frames"].as_array().unwrap();
        let ids: Vec<&str> = frames
            .iter()
            .map(|frame| frame["id"].as_str().unwrap())
            .collect();
        assert_eq!(ids, ["kitchen/2", "seed0/kitchen/1"]);
        assert_eq!(frames[0]["failure"], "it has no depth");
        frames[1]["error"].as_f64().unwrap()
    });
    assert_eq!(errors, [0.2, 0.1]);
}
