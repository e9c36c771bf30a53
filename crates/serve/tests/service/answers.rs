//! Answers match the library bit for bit.

use crate::client::{Reply, Running, asset, asset_path, completer, file, text};
use lsdc_core::settings::{FitConfig, FitMethod, Loss, Robust};
use lsdc_core::{Channels, Completion, Image, Scene};
use lsdc_files::{Camera, CloudOptions, ColoredCloud, DeviationLimits, Sparse, read_rgb};
use lsdc_serve::Config;

const CAMERA: &str = "260,260,151.5,113.5";

fn scene(fit: FitConfig) -> Scene {
    let rgb = read_rgb(&asset_path("rgb.png")).unwrap();
    let (width, height) = (rgb.width() as usize, rgb.height() as usize);
    let image = Image::new(width, height, Channels::Rgb, rgb.as_raw()).unwrap();
    completer().with_fit(fit).scene(&image).unwrap()
}

fn expected(fit: FitConfig) -> Completion {
    let scene = scene(fit);
    let size = (scene.width(), scene.height());
    let points = Sparse::read(&asset_path("sparse.npy"), None, None, size).unwrap();
    scene.complete(&points.points).unwrap()
}

/// Returns the bytes of each format, as written by the library.
fn forms(found: &Completion) -> Vec<(&'static str, Vec<u8>)> {
    let (depth, deviation) = (found.depth().unwrap(), found.standard_deviation().unwrap());
    let rgb = read_rgb(&asset_path("rgb.png")).unwrap();
    let camera = Camera::pinhole([260.0; 2], [151.5, 113.5]);
    let camera = camera.resized((depth.width(), depth.height())).unwrap();
    // A pixel counts as not measured if its standard deviation is above a tenth of its depth.
    let options = CloudOptions {
        limits: DeviationLimits {
            absolute: None,
            relative: Some(0.1),
        },
        ..CloudOptions::default()
    };
    let cloud = ColoredCloud::new(&depth, Some(&deviation), &rgb, &camera, &options);
    vec![
        (
            "image/png",
            lsdc_files::encode_depth_png(&depth, 0.001).unwrap(),
        ),
        (
            "image/x-exr",
            lsdc_files::encode_exr(&depth, Some(&deviation)).unwrap(),
        ),
        (
            "application/x-npz",
            lsdc_files::encode_npz(&[("depth", &depth), ("sigma", &deviation)]).unwrap(),
        ),
        (
            "application/x-ply",
            lsdc_files::encode_ply(&cloud.points).unwrap(),
        ),
    ]
}

/// Decodes the header and the maps of the page's format.
fn layers(reply: &Reply) -> (serde_json::Value, Vec<f32>) {
    let (length, rest) = reply.body.split_at(4);
    let length = u32::from_le_bytes(length.try_into().unwrap()) as usize;
    assert_eq!(length % 4, 0);
    let (header, maps) = rest.split_at(length);
    let values = maps.chunks_exact(4);
    let values = values.map(|four| f32::from_le_bytes(four.try_into().unwrap()));
    (serde_json::from_slice(header).unwrap(), values.collect())
}

#[test]
fn every_form_is_that_of_the_library() {
    let service = Running::new(Config::default());
    let (rgb, sparse) = (asset("rgb.png"), asset("sparse.npy"));
    let own = *completer().fit_config();
    let posted = service.post(
        "/v1/scenes",
        "*/*",
        &[file("image", "rgb.png", &rgb), text("camera", CAMERA)],
    );
    assert_eq!(posted.status, 201, "{posted:?}");
    let scene = posted.header("location").unwrap().to_owned() + "/complete";
    let fits = [
        ("{}", own),
        (
            "{\"robust\": \"auto\"}",
            FitConfig {
                robust: Some(Robust::new(Loss::Auto)),
                ..own
            },
        ),
        (
            "{\"fit\": \"lse\"}",
            own.changed(&lsdc_core::fit::Changes {
                method: Some(FitMethod::Lse),
                ..Default::default()
            }),
        ),
    ];
    for (options, fit) in fits {
        let found = expected(fit);
        let points = [
            file("points", "sparse.npy", &sparse),
            text("options", options),
        ];
        let all = [
            file("image", "rgb.png", &rgb),
            text("camera", CAMERA),
            points[0],
            points[1],
        ];
        for (form, bytes) in forms(&found) {
            for reply in [
                service.post("/v1/complete", form, &all),
                service.post(&scene, form, &points),
            ] {
                assert_eq!(reply.status, 200, "{form} {options}");
                assert_eq!(reply.header("content-type"), Some(form));
                assert!(reply.body == bytes, "{form} {options}");
                let report = reply.header("lsdc-report").unwrap();
                let report: serde_json::Value = serde_json::from_str(report).unwrap();
                assert_eq!(report["points"]["used"], found.report().used);
            }
        }
        for reply in [
            service.post("/v1/complete", "application/vnd.lsdc.layers", &all),
            service.post(&scene, "application/vnd.lsdc.layers", &points),
        ] {
            let (header, values) = layers(&reply);
            let (depth, deviation) = (found.depth().unwrap(), found.standard_deviation().unwrap());
            assert!(
                values == [depth.values(), deviation.values()].concat(),
                "{options}"
            );
            let area = 4 * depth.values().len();
            assert_eq!(header["layers"][1]["name"], "standard_deviation");
            assert_eq!(header["layers"][1]["offset"], area);
            assert_eq!(header["width"], depth.width());
            check_points(&header, &found);
            check_report(&header["report"], &found);
        }
        let report = service
            .post("/v1/complete", "application/json", &all)
            .json();
        check_report(&report, &found);
    }
}

#[test]
fn clouds_leave_out_what_is_not_measured_and_count_it() {
    let service = Running::new(Config::default());
    let (rgb, camera) = (asset("rgb.png"), text("camera", CAMERA));
    // Three points in the image: far from them, standard deviations are above a tenth of the depth.
    let points = text("points", "[[20, 20, 2], [60, 40, 2.5], [40, 90, 2.2]]");
    let image = file("image", "rgb.png", &rgb);
    let mut counts = Vec::new();
    for options in [
        "{\"keep_flying\": true}",
        "{\"keep_flying\": true, \"max_relative_sigma\": 0.1}",
        "{\"keep_flying\": true, \"max_relative_sigma\": 1e6}",
    ] {
        let parts = [image, points, camera, text("options", options)];
        let reply = service.post("/v1/complete", "application/x-ply", &parts);
        assert_eq!(reply.status, 200, "{reply:?}");
        let report = reply.header("lsdc-report").unwrap();
        let report: serde_json::Value = serde_json::from_str(report).unwrap();
        let count = |name: &str| report["cloud"][name].as_u64().unwrap();
        assert_eq!(count("points") + count("uncertain"), 304 * 228, "{options}");
        counts.push(count("uncertain"));
    }
    let [by_default, given, none] = counts[..] else {
        unreachable!()
    };
    assert!(
        by_default > 0 && by_default == given && none == 0,
        "{counts:?}"
    );
}

/// Checks the results at each point.
fn check_points(header: &serde_json::Value, found: &Completion) {
    let (residuals, others) = (found.residuals(), found.leave_one_out());
    let outliers = found.outliers().unwrap();
    let points = header["points"].as_array().unwrap();
    assert_eq!(points.len(), found.report().used);
    for point in points {
        let index = point["index"].as_u64().unwrap() as usize;
        assert_eq!(point["residual"].as_f64(), Some(residuals[index]));
        let expected = Some(others[index]).filter(|error| error.is_finite());
        assert_eq!(point["leave_one_out"].as_f64(), expected);
        let outlier = outliers.iter().find(|outlier| outlier.index == index);
        assert_eq!(
            point["outlier"].as_f64(),
            outlier.map(|outlier| outlier.probability)
        );
        assert_eq!(point["outlier"] == false, outlier.is_none());
    }
}

fn check_report(report: &serde_json::Value, found: &Completion) {
    let depth = found.depth().unwrap();
    let (lowest, highest) = depth.range().unwrap();
    assert_eq!(
        report["depth"]["lowest"].as_f64().map(|v| v as f32),
        Some(lowest)
    );
    assert_eq!(
        report["depth"]["highest"].as_f64().map(|v| v as f32),
        Some(highest)
    );
    assert_eq!(
        report["fit"]["residual"].as_f64(),
        Some(found.report().residual)
    );
    assert_eq!(
        report["fit"]["leave_one_out"].as_f64(),
        found.leave_one_out_error()
    );
    assert_eq!(report["fit"]["outliers"], found.outliers().unwrap().len());
    assert!(report["seconds"]["network"].as_f64().unwrap() > 0.0);
}

#[test]
fn points_may_be_a_list_and_what_is_left_out_is_said() {
    let service = Running::new(Config::default());
    let rgb = asset("rgb.png");
    let list =
        "[[10, 20, 2.0], [200.5, 100, 2.5, 0.1], [-9, 0, 1], [1, 1, -3], [150, 50, 3, null]]";
    let image = file("image", "rgb.png", &rgb);
    let layers_of =
        |parts: &[_]| layers(&service.post("/v1/complete", "application/vnd.lsdc.layers", parts));
    let (header, _) = layers_of(&[image, text("points", list)]);
    let report = &header["report"];
    assert_eq!(report["points"]["used"], 3);
    assert_eq!(report["points"]["outside"], 1);
    assert_eq!(report["points"]["ignored"], 1);
    let remarks = report["remarks"].to_string();
    assert!(
        remarks.contains("2 points have no usable standard deviation"),
        "{remarks}"
    );
    let index = |number: usize| header["points"][number]["index"].clone();
    assert_eq!([index(0), index(1), index(2)], [0, 1, 4]);

    // The same points as JSON, for a scene.
    let scene = service.post("/v1/scenes", "*/*", &[image]).json();
    let scene = format!("/v1/scenes/{}/complete", scene["id"].as_str().unwrap());
    let json = format!("{{\"points\": {list}, \"options\": {{\"layers\": [\"depth\"]}}}}");
    let headers = [
        ("content-type", "application/json"),
        ("accept", "application/vnd.lsdc.layers"),
    ];
    let (quick, depth) = layers(&service.ask("POST", &scene, &headers, json.as_bytes()));
    let (full, all) = layers_of(&[image, text("points", list)]);
    assert_eq!(quick["layers"].as_array().unwrap().len(), 1);
    assert!(depth == all[..depth.len()]);
    assert_eq!(quick["points"][0]["outlier"], serde_json::Value::Null);
    assert_eq!(full["points"][0]["outlier"], false);

    // One standard deviation for all points without their own.
    let options = text("options", "{\"sigma\": 0.1}");
    let (header, _) = layers_of(&[image, text("points", list), options]);
    assert_eq!(header["report"]["remarks"].as_array().unwrap().len(), 0);
}

/// Every answer contains the remarks on image, camera and points, with the client's names of the files.
#[test]
fn doubts_of_all_files_are_remarks() {
    let service = Running::new(Config::default());
    // 12-bit values in 16 bits.
    let rgb = image::load_from_memory(&asset("rgb.png")).unwrap();
    let deep = image::ImageBuffer::from_fn(rgb.width(), rgb.height(), |x, y| {
        let image::Rgba([r, g, b, _]) = image::GenericImageView::get_pixel(&rgb, x, y);
        image::Rgb([r, g, b].map(|value| u16::from(value) * 16))
    });
    let mut png = std::io::Cursor::new(Vec::new());
    let deep: image::ImageBuffer<image::Rgb<u16>, Vec<u16>> = deep;
    deep.write_to(&mut png, image::ImageFormat::Png).unwrap();
    let (png, sparse) = (png.into_inner(), asset("sparse.npy"));
    let camera = b"fx = 200\nfy = 200\ncx = 2000\ncy = 100\nwidth = 304\nheight = 228\n";
    let frame = [
        file("image", "rgb.png", &png),
        file("camera", "camera.toml", camera),
    ];
    let points = file("points", "../lidar_range.npy", &sparse);
    let words = |answer: &serde_json::Value, words: &[&str]| {
        let remarks: Vec<_> = answer.as_array().unwrap().iter().collect();
        for word in words {
            let found = remarks
                .iter()
                .any(|remark| remark.to_string().contains(word));
            assert!(found, "{word}: {remarks:?}");
        }
    };
    let all = ["4095 to white", "principal point", "`lidar_range`"];
    let reply = service.post("/v1/complete", "*/*", &[frame[0], frame[1], points]);
    words(&reply.json()["remarks"], &all);
    let scene = service.post("/v1/scenes", "*/*", &frame).json();
    words(&scene["remarks"], &all[..2]);
    let path = format!("/v1/scenes/{}/complete", scene["id"].as_str().unwrap());
    let reply = service.post(&path, "application/vnd.lsdc.layers", &[points]);
    words(&layers(&reply).0["report"]["remarks"], &all);
    // Millimetres in a list that must be in metres.
    let list = "{\"points\": [[10, 20, 2000], [200, 100, 2500], [150, 50, 3000]]}";
    let json = [("content-type", "application/json")];
    let reply = service.ask("POST", &path, &json, list.as_bytes());
    words(&reply.json()["remarks"], &["median depth is 2500 m"]);
}

#[test]
fn a_single_click_is_enough() {
    let service = Running::new(Config::default());
    let rgb = asset("rgb.png");
    let parts = [
        file("image", "rgb.png", &rgb),
        text("points", "[[150, 110, 2.5]]"),
    ];
    let reply = service.post("/v1/complete", "application/vnd.lsdc.layers", &parts);
    assert_eq!(
        reply.status,
        200,
        "{}",
        String::from_utf8_lossy(&reply.body)
    );
    let (header, values) = layers(&reply);
    let at = values[110 * 304 + 150];
    assert!((at / 2.5 - 1.0).abs() < 0.05, "{at}");
    // Each layer that cannot be estimated is replaced by a remark.
    let layers = header["layers"].as_array().unwrap().len();
    let remarks = header["report"]["remarks"].as_array().unwrap().len();
    assert_eq!(layers + remarks, 2, "{header}");
}
