//! Every command of the user guide, on files of the names that it uses.

use super::*;
use lsdc::data::{Camera, read_rgb, write_depth_png};
use std::fmt::Write as _;

/// Lines of the shell in the guide.
fn commands() -> Vec<String> {
    let guide = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/guide.md");
    let guide = std::fs::read_to_string(guide).unwrap();
    let blocks = guide.split("```sh\n").skip(1);
    let lines = blocks.flat_map(|block| block.split("```").next().unwrap().lines());
    lines.map(str::to_owned).collect()
}

/// The camera file of the guide.
fn camera() -> String {
    let guide = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/guide.md");
    let guide = std::fs::read_to_string(guide).unwrap();
    let block = guide.split("```toml\n").nth(1).unwrap();
    block.split("```").next().unwrap().to_owned()
}

/// The files that the guide speaks of, all of them the room.
fn prepared() -> tempfile::TempDir {
    let folder = room();
    let at = |name: &str| folder.path().join(name);
    for name in ["images", "sparse/0", "frames", "points", "out"] {
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
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&run.stderr);
        assert!(run.status.success(), "{command}: {said}");
    }
    for file in [
        "out/slam/keyframe_depth.npy",
        "out/robust/keyframe_outliers.csv",
        "out/cloud/street_cloud.ply",
        "out/clouds/view_cloud.ply",
        "out/list/frames/2_depth.npy",
        "out/sure/color_sigma.npy",
        "depth.npy",
        "lsdc.bash",
        "man1/lsdc.1",
    ] {
        assert!(folder.path().join(file).is_file(), "{file} is missing");
    }
}
