//! Runs every command of the user guide on files with the names used there.

use super::*;
use lsdc_eval::data::{Camera, read_rgb, write_depth_png, write_npy};
use std::fmt::Write as _;

/// Pages of the user guide whose commands are run.
const PAGES: [&str; 8] = [
    "guide",
    "phone",
    "depth-camera",
    "lidar",
    "colmap",
    "slam",
    "prediction",
    "formats",
];

/// The text of a page.
fn page(name: &str) -> String {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs");
    std::fs::read_to_string(docs.join(name).with_extension("md")).unwrap()
}

/// Shell commands of the pages.
fn commands() -> Vec<String> {
    let pages = PAGES.map(page).join("\n");
    let blocks = pages.split("```sh\n").skip(1);
    let lines = blocks.flat_map(|block| block.split("```").next().unwrap().lines());
    lines.map(str::to_owned).collect()
}

/// The camera file shown on the page on formats.
fn camera() -> String {
    let formats = page("formats");
    let block = formats.split("```toml\n").nth(1).unwrap();
    block.split("```").next().unwrap().to_owned()
}

/// A folder with the files that the guide mentions, all made from the room.
fn prepared() -> tempfile::TempDir {
    let folder = room();
    let at = |name: &str| folder.path().join(name);
    for name in [
        "images",
        "sparse/0",
        "frames",
        "points",
        "predictions",
        "out",
    ] {
        std::fs::create_dir_all(at(name)).unwrap();
    }
    let image = read_rgb(&at("rgb.png")).unwrap();
    for name in [
        "keyframe.jpg",
        "color.png",
        "street.png",
        "photo.jpg",
        "images/view.png",
        "frames/1.png",
        "frames/2.png",
    ] {
        image.save(at(name)).unwrap();
    }
    let sparse = read_npy(&at("sparse.npy"), 1.0).unwrap();
    let (width, height) = (sparse.width(), sparse.height());
    write_depth_png(&at("aligned_depth.png"), &sparse, 0.001).unwrap();
    for name in ["points/1.npy", "points/2.npy"] {
        std::fs::copy(at("sparse.npy"), at(name)).unwrap();
    }
    let truth = read_npy(&asset("depth.npy"), 1.0).unwrap();
    let disparities = truth.values().iter().map(|d| 3.0 / d - 0.2).collect();
    let prediction = DepthMap::new(width, height, disparities).unwrap();
    write_npy(&at("prediction.npy"), &prediction).unwrap();
    for name in ["predictions/1.npy", "predictions/2.npy"] {
        write_npy(&at(name), &truth).unwrap();
    }
    std::fs::write(at("list.txt"), "frames/1.png\nframes/2.png points/1.npy\n").unwrap();
    let small = DepthMap::new(width / 2, height / 2, vec![2.0; width * height / 4]).unwrap();
    write_depth_png(&at("arkit.png"), &small, 0.001).unwrap();

    std::fs::write(at("camera.toml"), camera()).unwrap();
    let seen = Camera::read(&at("camera.toml")).unwrap();
    let seen = seen.resized((width, height)).unwrap();
    let (mut features, mut scan) = ("u,v,depth,sigma\n".to_owned(), String::new());
    let (mut keypoints, mut landmarks) = (String::new(), String::new());
    for (i, p) in sparse.points().enumerate() {
        let (u, v, z) = (p.x as f64, p.y as f64, f64::from(p.depth));
        writeln!(features, "{u},{v},{z},0.01").unwrap();
        let [x, y, z] = seen.unproject([u, v], z).unwrap();
        writeln!(scan, "{x} {y} {z}").unwrap();
        write!(keypoints, "{} {} {i} ", u + 0.5, v + 0.5).unwrap();
        let (x, y) = ((u - 152.0) / 200.0 * z, (v - 114.0) / 200.0 * z);
        writeln!(landmarks, "{i} {x} {y} {z} 0 0 0 0.5 1 0 2 0").unwrap();
    }
    std::fs::write(at("features.csv"), features).unwrap();
    let count = sparse.count();
    let head = format!(
        "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {count}\nHEIGHT 1\n\
         VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA ascii\n"
    );
    std::fs::write(at("scan.pcd"), head + &scan).unwrap();
    let cameras = format!("1 SIMPLE_PINHOLE {width} {height} 200 152.5 114.5\n");
    std::fs::write(at("sparse/0/cameras.txt"), cameras).unwrap();
    let images = format!("1 1 0 0 0 0 0 0 1 view.png\n{keypoints}\n");
    std::fs::write(at("sparse/0/images.txt"), images).unwrap();
    std::fs::write(at("sparse/0/points3D.txt"), landmarks).unwrap();
    folder
}

#[test]
fn every_command_works() {
    let folder = prepared();
    let commands = commands();
    assert!(commands.len() > 20, "{} commands", commands.len());
    let program = Path::new(env!("CARGO_BIN_EXE_lsdc"));
    let path = std::env::var_os("PATH").unwrap_or_default();
    let places = std::iter::once(program.parent().unwrap().to_owned());
    let places = places.chain(std::env::split_paths(&path));
    let path = std::env::join_paths(places).unwrap();
    for command in commands {
        let run = Command::new("sh")
            .args(["-c", &command])
            .current_dir(folder.path())
            .env("PATH", &path)
            .env("LSDC_WEIGHTS", folder.path().join("nowhere"))
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&run.stderr);
        assert!(run.status.success(), "{command}: {said}");
    }
    check_depths(folder.path());
    let at = |name: &str| folder.path().join(name);
    let given = read_npy(&at("sparse.npy"), 1.0).unwrap();
    // Measured depths are kept.
    let filled = read_npy(&at("out/filled/color_depth.npy"), 1.0).unwrap();
    for p in given.points() {
        assert!((filled.at(p.x, p.y) - p.depth).abs() < 0.0006, "{p:?}");
    }
    let sigma = read_npy(&at("out/sure/color_sigma.npy"), 1.0).unwrap();
    assert_eq!(sigma.count(), sigma.values().len());
    assert!(sigma.range().unwrap().1 < 5.0, "{:?}", sigma.range());
    let outliers = std::fs::read_to_string(at("out/robust/keyframe_outliers.csv")).unwrap();
    let (header, lines) = outliers.split_once('\n').unwrap();
    for line in lines.lines() {
        let numbers = line.split(',').map(|v| v.parse::<f64>().unwrap());
        assert_eq!(numbers.count(), header.split(',').count(), "{line}");
    }
    for cloud in ["out/cloud/street_cloud.ply", "out/clouds/view_cloud.ply"] {
        let bytes = std::fs::read(at(cloud)).unwrap();
        let text = String::from_utf8_lossy(&bytes[..200]).into_owned();
        let count = text.split("element vertex ").nth(1).unwrap();
        let count: usize = count.lines().next().unwrap().parse().unwrap();
        // Most pixels have standard deviations below 0.3 m, but not all.
        assert!((30_000..304 * 228).contains(&count), "{cloud}: {count}");
    }
    let bash = std::fs::read_to_string(at("lsdc.bash")).unwrap();
    assert!(bash.contains("--depth-unit") && bash.contains("complete"));
    let page = std::fs::read_to_string(at("man1/lsdc-complete.1")).unwrap();
    assert!(page.contains("camera"), "{page}");
}

/// Checks that every depth map that the guide computes is near the ground truth at every pixel.
fn check_depths(folder: &Path) {
    let truth = read_npy(&asset("depth.npy"), 1.0).unwrap();
    let mut found = vec![folder.join("depth.npy")];
    let mut folders = vec![folder.join("out")];
    while let Some(below) = folders.pop() {
        for entry in std::fs::read_dir(below).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.to_string_lossy().ends_with("_depth.npy") {
                found.push(path);
            }
        }
    }
    assert!(found.len() >= 15, "{} maps", found.len());
    for path in found {
        let depth = read_npy(&path, 1.0).unwrap();
        let size = (depth.width(), depth.height());
        assert_eq!(size, (truth.width(), truth.height()), "{}", path.display());
        let of = |name: &str| path.starts_with(folder.join("out").join(name));
        // Few pixels are left empty.
        let least = if of("sparing") { 0.9 } else { 1.0 };
        let share = depth.count() as f64 / depth.values().len() as f64;
        assert!(share >= least, "{}: {share}", path.display());
        // The phone's map is 2 m everywhere.
        let phone = of("arkit");
        let pairs = depth.values().iter().zip(truth.values());
        let pairs = pairs.filter(|(a, _)| **a > 0.0);
        let off = pairs.map(|(a, b)| {
            let b = if phone { 2.0 } else { *b };
            (a - b).abs() / b
        });
        let off = off.sum::<f32>() / depth.count() as f32;
        assert!(off < 0.1, "{}: mean relative error {off}", path.display());
    }
}
