//! `lsdc fuse`: surfaces from completed frames.

use super::*;

const CAMERA: [&str; 2] = ["--camera", "60,60,39.5,29.5"];

/// A folder with three depth maps of a wall at z = 2 from positions along x, and their poses.
fn wall() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let results = folder.path().join("results");
    let images = folder.path().join("images");
    std::fs::create_dir(&results).unwrap();
    std::fs::create_dir(&images).unwrap();
    let mut rows = vec!["# timestamp tx ty tz qx qy qz qw".to_owned()];
    for index in 0..3 {
        let depth = DepthMap::new(80, 60, vec![2.0; 80 * 60]).unwrap();
        let sigma = DepthMap::new(80, 60, vec![0.01; 80 * 60]).unwrap();
        write_npy(&results.join(format!("10.{index}_depth.npy")), &depth).unwrap();
        write_npy(&results.join(format!("10.{index}_sigma.npy")), &sigma).unwrap();
        let image = image::RgbImage::from_pixel(80, 60, image::Rgb([200, 100, 50]));
        image.save(images.join(format!("10.{index}.png"))).unwrap();
        rows.push(format!(
            "10.{index}01 {} 0 0 0 0 0 1",
            f64::from(index) * 0.1
        ));
    }
    std::fs::write(folder.path().join("poses.txt"), rows.join("\n")).unwrap();
    folder
}

fn fuse(folder: &Path, more: &[&str]) -> Command {
    let mut command = lsdc(folder);
    command
        .args(["fuse", "results", "--poses", "poses.txt"])
        .args(more);
    command
}

#[test]
fn a_wall_becomes_a_surface() {
    let folder = wall();
    let at = |name: &str| folder.path().join(name);
    let run = fuse(
        folder.path(),
        &["-o", "scene.ply", "--images", "images", "--json"],
    )
    .args(CAMERA)
    .assert();
    let said: serde_json::Value = serde_json::from_str(&text(&run.success())).unwrap();
    assert_eq!(
        (&said["frames"], &said["frames_without_pose"]),
        (&3.into(), &0.into())
    );
    // Twice the width of a pixel (2 / 60 m), rounded to two digits.
    assert!(
        (said["voxel"].as_f64().unwrap() - 0.067).abs() < 1e-9,
        "{said}"
    );
    assert_eq!(said["uncoloured_vertices"], 0);
    let vertices = said["vertices"].as_u64().unwrap() as usize;
    let triangles = said["triangles"].as_u64().unwrap() as usize;
    let bytes = std::fs::read(at("scene.ply")).unwrap();
    let end = bytes
        .windows(11)
        .position(|w| w == b"end_header\n")
        .unwrap()
        + 11;
    // Vertices: position, normal and colour. Faces: a count and three indices.
    assert_eq!(bytes.len(), end + vertices * 27 + triangles * 13);
    for vertex in bytes[end..end + vertices * 27].chunks_exact(27) {
        let z = f32::from_le_bytes(vertex[8..12].try_into().unwrap());
        assert!((z - 2.0).abs() < 1e-4, "{z}");
        assert_eq!(vertex[24..], [200, 100, 50]);
    }

    let run = fuse(folder.path(), &["-o", "scene.glb", "--voxel", "0.05"])
        .args(CAMERA)
        .assert();
    let told = text(&run.success());
    assert!(told.contains("frames    3 of 3"), "{told}");
    assert!(
        told.contains("up        -y of the world, by the cameras"),
        "{told}"
    );
    assert_eq!(&std::fs::read(at("scene.glb")).unwrap()[..4], b"glTF");

    let points = ["-o", "points.ply", "--points", "--every", "2"];
    let run = fuse(folder.path(), &points).args(CAMERA).assert().success();
    assert!(text(&run).contains("frames    2 of 2"));
    // The program reads the cloud.
    let run = lsdc(folder.path())
        .args(["inspect", "points.ply"])
        .assert()
        .success();
    assert!(
        text(&run).contains("z         2.000 to 2.000"),
        "{}",
        text(&run)
    );
}

#[test]
fn frames_without_a_pose_and_small_memory_are_said() {
    let folder = wall();
    let poses = std::fs::read_to_string(folder.path().join("poses.txt")).unwrap();
    let broken = poses.replace("10.201 0.2", "10.201 nan");
    std::fs::write(folder.path().join("poses.txt"), broken).unwrap();
    let run = fuse(
        folder.path(),
        &["-o", "scene.ply", "--max-memory", "0.0001"],
    )
    .args(CAMERA)
    .assert();
    let run = run.success();
    assert!(
        text(&run).contains("frames    2 of 3, 1 without a pose"),
        "{}",
        text(&run)
    );
    let warnings = String::from_utf8(run.get_output().stderr.clone()).unwrap();
    assert!(warnings.contains("1 of 3 poses are left out"), "{warnings}");
    assert!(
        warnings.contains("all frames are fused again in voxels of 0.134 m"),
        "{warnings}"
    );
    // A given voxel size is kept.
    let small = [
        "-o",
        "small.ply",
        "--max-memory",
        "0.0001",
        "--voxel",
        "0.05",
    ];
    failed(
        fuse(folder.path(), &small).args(CAMERA),
        2,
        &["MiB are allowed", "hint:"],
    );
}

#[test]
fn what_is_missing_is_named() {
    let folder = wall();
    let refused = |args: &[&str], words: &[&str]| {
        let all = [&["fuse", "results", "--poses", "poses.txt"], args].concat();
        refused(folder.path(), &all, words);
    };
    refused(
        &["-o", "scene.ply"],
        &["frame `10.0` has no camera", "--camera"],
    );
    refused(
        &["-o", "scene.obj", CAMERA[0], CAMERA[1]],
        &["neither .ply nor .glb"],
    );
    refused(
        &["-o", "poses.txt", CAMERA[0], CAMERA[1]],
        &["neither .ply nor .glb"],
    );
    refused(
        &[
            "-o",
            "scene.ply",
            CAMERA[0],
            CAMERA[1],
            "--images",
            "results",
        ],
        &["has no image of frame `10.0`"],
    );
    std::fs::write(folder.path().join("poses.txt"), "99 0 0 0 0 0 0 1\n").unwrap();
    refused(
        &["-o", "scene.ply", CAMERA[0], CAMERA[1]],
        &["none of 3 frames has a pose", "hint:"],
    );
}
