//! Workspaces for COLMAP, Gaussian splatting and nerfstudio, as `complete --export` writes them.

use super::*;
use serde_json::Value;

/// Files of the workspaces of two images.
const FILES: [(&str, &[&str]); 3] = [
    (
        "colmap",
        &[
            "images/a.png",
            "images/b/c.png",
            "sparse/cameras.txt",
            "sparse/images.txt",
            "sparse/points3D.txt",
            "stereo/depth_maps/a.png.geometric.bin",
            "stereo/depth_maps/b/c.png.geometric.bin",
            "stereo/fusion.cfg",
            "stereo/normal_maps/a.png.geometric.bin",
            "stereo/normal_maps/b/c.png.geometric.bin",
            "stereo/patch-match.cfg",
        ],
    ),
    (
        "nerfstudio",
        &[
            "depths/a.png.png",
            "depths/b/c.png.png",
            "images/a.png",
            "images/b/c.png",
            "transforms.json",
        ],
    ),
    (
        "splatting",
        &[
            "depths/a.png",
            "depths/b/c.png",
            "images/a.png",
            "images/b/c.png",
            "sparse/0/cameras.txt",
            "sparse/0/depth_params.json",
            "sparse/0/images.txt",
            "sparse/0/points3D.txt",
        ],
    ),
];

/// A folder with the room as two images, and a model whose points are its sparse depths.
fn scene(camera: &str) -> tempfile::TempDir {
    let folder = room();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir_all(at("images/b")).unwrap();
    std::fs::create_dir(at("model")).unwrap();
    for name in ["images/a.png", "images/b/c.png"] {
        std::fs::copy(at("rgb.png"), at(name)).unwrap();
    }
    let sparse = read_npy(&at("sparse.npy"), 1.0).unwrap();
    let (width, height) = (sparse.width(), sparse.height());
    let (model, distortion) = camera.split_once(' ').unwrap_or((camera, ""));
    let camera = format!("1 {model} {width} {height} 200 200 150 110 {distortion}\n");
    std::fs::write(at("model/cameras.txt"), camera).unwrap();
    let (mut seen, mut points) = (Vec::new(), Vec::new());
    for (i, p) in sparse.points().enumerate() {
        let (u, v, z) = (p.x as f64 + 0.5, p.y as f64 + 0.5, f64::from(p.depth));
        let (x, y) = ((u - 150.0) * z / 200.0, (v - 110.0) * z / 200.0);
        seen.push(format!("{u} {v} {i}"));
        points.push(format!("{i} {x} {y} {z} 0 0 0 0.5 1 0 2 0"));
    }
    let seen = seen.join(" ");
    let pose = "1 0 0 0 0 0 0 1";
    let images = format!("1 {pose} a.png\n{seen}\n2 {pose} b/c.png\n{seen}\n");
    std::fs::write(at("model/images.txt"), images).unwrap();
    std::fs::write(at("model/points3D.txt"), points.join("\n")).unwrap();
    folder
}

const ALL: [&str; 8] = [
    "complete",
    "images",
    "model",
    "-o",
    "out",
    "--method",
    "nearest",
    "--export=colmap,splatting,nerfstudio",
];

fn run(folder: &Path, args: &[&str]) -> String {
    text(&lsdc(folder).args(args).assert().success())
}

/// All files below a folder with their contents, except hidden ones.
fn files(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        if name.starts_with('.') {
            continue;
        }
        if path.is_dir() {
            let below = files(&path).into_iter();
            found.extend(below.map(|(file, bytes)| (format!("{name}/{file}"), bytes)));
        } else {
            found.push((name, std::fs::read(&path).unwrap()));
        }
    }
    found.sort();
    found
}

/// Reads the numbers of a COLMAP map.
fn floats(path: &Path, head: &str) -> Vec<f32> {
    let bytes = std::fs::read(path).unwrap();
    let (numbers, rest) = bytes
        .strip_prefix(head.as_bytes())
        .unwrap_or_else(|| panic!("{} does not begin with {head}", path.display()))
        .as_chunks::<4>();
    assert!(rest.is_empty());
    numbers.iter().copied().map(f32::from_le_bytes).collect()
}

/// Reads the values of a 16-bit PNG.
fn values(path: &Path) -> Vec<u16> {
    image::open(path).unwrap().into_luma16().into_raw()
}

#[test]
fn every_program_gets_the_same_depths() {
    let folder = scene("PINHOLE");
    let at = |name: &str| folder.path().join("out").join(name);
    let told = run(folder.path(), &ALL);
    for (tool, expected) in FILES {
        assert!(told.contains(&format!("2 images for {tool} in out/{tool}")));
        let found: Vec<String> = files(&at(tool)).into_iter().map(|(name, _)| name).collect();
        assert_eq!(found, expected, "{tool}");
    }
    // No depth maps unless requested.
    assert_eq!(names(&at("")), ["colmap", "nerfstudio", "splatting"]);

    let mut also = ALL;
    also[4] = "plain";
    also[7] = "--formats=npy";
    run(folder.path(), &also);
    let depth = read_npy(&folder.path().join("plain/b/c_depth.npy"), 1.0).unwrap();
    let head = format!("{}&{}&", depth.width(), depth.height());
    let maps = at("colmap/stereo/depth_maps/b/c.png.geometric.bin");
    assert_eq!(floats(&maps, &format!("{head}1&")), depth.values());
    let normals = floats(
        &at("colmap/stereo/normal_maps/a.png.geometric.bin"),
        &format!("{head}3&"),
    );
    let count = depth.values().len();
    for i in 0..count {
        let [x, y, z] = [0, 1, 2].map(|axis| normals[axis * count + i]);
        assert!((x * x + y * y + z * z - 1.0).abs() < 1e-5, "{i}");
    }

    // Decode like the loader of Gaussian splatting.
    let parameters = json(&at("splatting/sparse/0/depth_params.json"));
    let scale = parameters["b/c"]["scale"].as_f64().unwrap();
    assert_eq!(parameters["a"], parameters["b/c"]);
    for (value, depth) in values(&at("splatting/depths/b/c.png"))
        .iter()
        .zip(depth.values())
    {
        let inverse = f64::from(*value) / 65536.0 * scale;
        assert!((inverse - 1.0 / f64::from(*depth)).abs() <= 0.5001 * scale / 65536.0);
    }

    let millimetres = values(&at("nerfstudio/depths/b/c.png.png"));
    for (value, depth) in millimetres.iter().zip(depth.values()) {
        assert!((f64::from(*value) * 1e-3 - f64::from(*depth)).abs() < 0.501e-3);
    }
    let frames = &json(&at("nerfstudio/transforms.json"))["frames"];
    assert_eq!(frames[1]["fl_x"], 200.0);
    assert_eq!(frames[1]["cx"], 150.0);
    assert_eq!(frames[1]["transform_matrix"][1][1], -1.0);
    assert_eq!(frames[1]["transform_matrix"][2][2], -1.0);
}

#[test]
fn workspaces_are_in_the_unit_of_the_model() {
    let folder = scene("PINHOLE");
    run(folder.path(), &ALL);
    // The unit of the model is half a metre: results are in metres, the workspace is in units of the model.
    let mut args = ALL.to_vec();
    args[4] = "metres";
    args.extend(["--depth-unit", "2"]);
    run(folder.path(), &args);
    let map = "colmap/stereo/depth_maps/a.png.geometric.bin";
    let read = |output: &str| std::fs::read(folder.path().join(output).join(map)).unwrap();
    assert_eq!(read("out"), read("metres"));
}

#[test]
fn a_run_goes_on_with_what_is_left() {
    let folder = scene("PINHOLE");
    let at = |name: &str| folder.path().join("out").join(name);
    let shard = [&ALL[..], &["--shard", "0/2"]].concat();
    run(folder.path(), &shard);
    let told = run(folder.path(), &ALL);
    assert!(told.contains("2 images for splatting"), "{told}");
    let whole = files(&at(""));
    for name in [
        "splatting/depths/a.png",
        "colmap/stereo/normal_maps/b/c.png.geometric.bin",
        "nerfstudio/images/a.png",
    ] {
        std::fs::remove_file(at(name)).unwrap();
        let told = run(folder.path(), &ALL);
        assert!(told.contains("1 completed, 1 there already"), "{told}");
        assert!(files(&at("")) == whole, "{name}");
    }
    // Copies of the images in the workspace are not completed.
    let mut within = ALL;
    within[4] = "images";
    run(folder.path(), &within);
    let told = run(folder.path(), &within);
    assert!(told.contains("0 completed, 2 there already"), "{told}");
}

#[test]
fn uncertain_pixels_are_empty_and_counted() {
    let folder = scene("PINHOLE");
    let at = |name: &str| folder.path().join(name);
    let complete = [
        "complete",
        "images/a.png",
        "model",
        "--uncertainty",
        "-o",
        "all",
    ];
    run(folder.path(), &complete);
    let depth = read_npy(&at("all/a_depth.npy"), 1.0).unwrap();
    let sigma = read_npy(&at("all/a_sigma.npy"), 1.0).unwrap();
    let pairs = || depth.values().iter().zip(sigma.values());
    let mut shares: Vec<f32> = pairs().map(|(z, s)| s / z).collect();
    shares.sort_by(f32::total_cmp);
    let limit = shares[shares.len() * 3 / 4];
    let expected: Vec<f32> = pairs()
        .map(|(z, s)| if s / z > limit { 0.0 } else { *z })
        .collect();
    let empty = expected.iter().filter(|z| **z == 0.0).count();
    assert!(empty > 1000);

    let text = limit.to_string();
    let export = ["--export=colmap,splatting", "--max-relative-sigma", &text];
    let base = ["complete", "images", "model", "-o", "out", "--json"];
    let told = run(folder.path(), &[&base[..], &export].concat());
    let reports: Vec<Value> = told
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let report = reports.iter().find(|report| report["image"] == "a.png");
    let counts = &report.unwrap()["exported"];
    assert_eq!(counts["uncertain"], empty);
    assert_eq!(counts["empty"], empty);
    let head = format!("{}&{}&1&", depth.width(), depth.height());
    let map = floats(
        &at("out/colmap/stereo/depth_maps/a.png.geometric.bin"),
        &head,
    );
    assert_eq!(map, expected);
    let codes = values(&at("out/splatting/depths/a.png"));
    for (code, depth) in codes.iter().zip(&expected) {
        assert_eq!(*code == 0, *depth == 0.0);
    }
    let mut other = base.to_vec();
    other[4] = "words";
    other.pop();
    let told = run(folder.path(), &[&other[..], &export].concat());
    assert!(
        told.contains("their standard deviation is too large"),
        "{told}"
    );
    assert!(told.contains("infinitely far"), "{told}");
}

#[test]
fn what_cannot_be_exported_is_refused() {
    let folder = scene("OPENCV 0.1 0 0 0");
    for tool in ["colmap", "splatting"] {
        let args = ["complete", "images", "model", "-o", "out", "--export", tool];
        let words = ["has distortion", "image_undistorter"];
        refused(folder.path(), &args, &words);
    }
    let nerfstudio = ["--export=nerfstudio", "--method=nearest"];
    let base = ["complete", "images", "model", "-o"];
    run(folder.path(), &[&base[..], &["out"], &nerfstudio].concat());
    let frames = &json(&folder.path().join("out/nerfstudio/transforms.json"))["frames"];
    assert_eq!(frames[0]["k1"], 0.1);
    for (args, words) in [
        (
            &["complete", "images/a.png", "model", "-o", "more"][..],
            "several images",
        ),
        (
            &["complete", "images", "images", "-o", "more"],
            "a COLMAP model",
        ),
        (
            &[
                "complete",
                "images",
                "model",
                "-o",
                "more",
                "--camera=1,1,1,1",
            ],
            "not `--camera`",
        ),
        (
            &[
                "complete",
                "images",
                "model",
                "-o",
                "more",
                "--export=brush",
            ],
            "colmap, splatting, nerfstudio",
        ),
    ] {
        let args = [args, &["--export=nerfstudio"]].concat();
        refused(folder.path(), &args, &[words]);
    }
    // A folder with files of another program.
    std::fs::create_dir_all(folder.path().join("mine/nerfstudio")).unwrap();
    std::fs::write(folder.path().join("mine/nerfstudio/transforms.json"), "{}").unwrap();
    let args = [&base[..], &["mine"], &nerfstudio].concat();
    refused(folder.path(), &args, &["is no workspace", "--force"]);
    let forced = [&args[..], &["--force"]].concat();
    run(folder.path(), &forced);
}
