use super::*;
use std::fs;

/// A camera at (2, 3, 1.5) that looks along the world's x axis; the world's z axis is up. This is the optical frame of ROS
/// (REP 103), whose quaternion is -0.5 0.5 -0.5 0.5.
const POSITION: [f64; 3] = [2.0, 3.0, 1.5];
const ROTATION: [[f64; 3]; 3] = [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]];
const ROW: &str = "2 3 1.5 -0.5 0.5 -0.5 0.5";
const MATRIX: &str = "0 0 1 2 -1 0 0 3 0 -1 0 1.5";

struct Scratch(tempfile::TempDir);

impl Scratch {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn write(&self, name: &str, text: &str) -> std::path::PathBuf {
        let path = self.0.path().join(name);
        fs::write(&path, text).unwrap();
        path
    }

    fn read(&self, name: &str, text: &str) -> Result<Poses> {
        Poses::open(&self.write(name, text))
    }
}

fn assert_is_there(pose: Option<Pose>) {
    let found = pose.expect("a pose").inverse();
    let numbers = found.rotation.iter().flatten().chain(&found.translation);
    let expected = ROTATION.iter().flatten().chain(&POSITION);
    for (number, expected) in numbers.zip(expected) {
        assert!((number - expected).abs() < 1e-9, "{found:?}");
    }
}

#[test]
fn every_format_gives_the_same_pose() {
    let scratch = Scratch::new();
    let tum = scratch.read(
        "a.txt",
        &format!("# timestamp tx ...\n1305031102.1758 {ROW}\n"),
    );
    assert_is_there(tum.unwrap().of("rgb/1305031102.175304.png"));
    let commas = format!(
        "time,x,y,z,qx,qy,qz,qw\n1305031102.1758,{}\n",
        ROW.replace(' ', ",")
    );
    assert_is_there(
        scratch
            .read("a.csv", &commas)
            .unwrap()
            .of("1305031102175304000"),
    );

    let kitti = scratch.read("00.txt", &format!("1 0 0 0 0 1 0 0 0 0 1 0\n{MATRIX}\n"));
    assert_is_there(kitti.unwrap().of("image_2/000001.png"));

    let folder = scratch.0.path().join("seq-01");
    fs::create_dir(&folder).unwrap();
    fs::write(
        folder.join("frame-000007.pose.txt"),
        format!("{MATRIX} 0 0 0 1"),
    )
    .unwrap();
    fs::write(folder.join("notes.txt"), "not a pose").unwrap();
    assert_is_there(Poses::open(&folder).unwrap().of("frame-000007.color.png"));

    // In OpenGL a camera looks along -z, with y up.
    let json = r#"{"fl_x": 500, "fl_y": 510, "cx": 320, "cy": 240, "w": 640, "h": 480, "frames": [{"file_path":
        "./images/frame_00001.jpg", "transform_matrix": [[0,0,-1,2],[-1,0,0,3],[0,1,0,1.5],[0,0,0,1]]}]}"#;
    let poses = scratch.read("transforms.json", json).unwrap();
    assert_is_there(poses.of("frame_00001.png"));
    let camera = poses.camera("images/frame_00001").unwrap();
    // Four metres ahead, one to the right (the world's y is left) and one up.
    let ([u, v], depth) = camera.project([6.0, 2.0, 2.5]).unwrap();
    assert!((depth - 4.0).abs() < 1e-12);
    assert!(
        (u - (319.5 + 125.0)).abs() < 1e-9 && (v - (239.5 - 127.5)).abs() < 1e-9,
        "{u} {v}"
    );
    assert_eq!(camera.size(), Some((640, 480)));
}

/// COLMAP stores the inverse: the conjugate of the quaternion, and (3, 1.5, -2).
#[test]
fn a_model_of_colmap_gives_poses_and_cameras() {
    let scratch = Scratch::new();
    scratch.write(
        "cameras.txt",
        "1 PINHOLE 640 480 500 510 320 240\n2 FOV 640 480 500 500 320 240 0.9\n",
    );
    let images = "1 0.5 0.5 -0.5 0.5 3 1.5 -2 1 cam/view.jpg\n\n2 1 0 0 0 0 0 0 2 other.jpg\n\n";
    scratch.write("images.txt", images);
    scratch.write("points3D.txt", "");
    let poses = Poses::open(scratch.0.path()).unwrap();
    assert_is_there(poses.of("view.png"));
    assert_eq!(
        poses.camera("cam/view").unwrap().intrinsics(),
        [500.0, 510.0, 319.5, 239.5]
    );
    assert_eq!((poses.len(), poses.ignored()), (1, 1));
    assert!(
        poses.warnings()[0].contains("`other.jpg`"),
        "{:?}",
        poses.warnings()
    );
}

#[test]
fn the_nearest_time_within_the_tolerance_is_taken() {
    let scratch = Scratch::new();
    let rows: Vec<String> = [10.0, 10.05, 10.1, 9.95]
        .iter()
        .map(|time| format!("{time} {time} 0 0 0 0 0 1"))
        .collect();
    let poses = scratch.read("a.txt", &rows.join("\n")).unwrap();
    let position = |name| poses.of(name).map(|pose| pose.inverse().translation[0]);
    assert_eq!(position("10.01"), Some(10.0));
    assert_eq!(position("10.04.png"), Some(10.05));
    assert_eq!(position("9.94"), Some(9.95));
    assert_eq!(position("10.119.png"), Some(10.1));
    assert_eq!(position("10.121.png"), None);
    assert_eq!(position("frame"), None);
    // Nanoseconds in the file, seconds in the name.
    let since = "1700000000250000000 1 0 0 0 0 0 1";
    let poses = scratch.read("b.txt", since).unwrap();
    assert!(poses.of("1700000000.26.png").is_some());
}

#[test]
fn names_may_differ_in_folders_and_endings_but_not_be_ambiguous() {
    let scratch = Scratch::new();
    let frame = |path: &str, x: f64| {
        format!(
            r#"{{"file_path": "{path}", "transform_matrix": [[1,0,0,{x}],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}}"#
        )
    };
    let frames = [
        frame("left/0001.png", 1.0),
        frame("right/0001.png", 2.0),
        frame("images/r_12", 3.0),
    ];
    let json = format!(
        r#"{{"camera_angle_x": 0.7, "frames": [{}]}}"#,
        frames.join(",")
    );
    let poses = scratch.read("transforms.json", &json).unwrap();
    let position = |name| poses.of(name).map(|pose| pose.inverse().translation[0]);
    assert_eq!(position("left/0001"), Some(1.0));
    assert_eq!(position("data/right/0001.jpg"), Some(2.0));
    assert_eq!(position("0001.png"), None);
    assert_eq!(position("r_12.png"), Some(3.0));
    // Without a width, the angle gives no focal length.
    assert!(poses.camera("r_12").is_none());
}

#[test]
fn broken_rows_are_counted_and_described() {
    let scratch = Scratch::new();
    let text =
        format!("1 {ROW}\n2 0 0 0 0 0 0 0\n3 nan 0 0 0 0 0 1\n4 1 2\n1 {ROW}\n5 0 0 x 0 0 0 1\n");
    let poses = scratch.read("a.txt", &text).unwrap();
    assert_eq!((poses.len(), poses.ignored()), (1, 5));
    let [warning] = poses.warnings() else {
        panic!("{:?}", poses.warnings())
    };
    let expected =
        "5 of 6 poses are left out; the first of them, line 2, holds a quaternion of zeros";
    assert_eq!(warning, expected);
    // An invalid row keeps its index.
    let kitti = scratch.read(
        "b.txt",
        &format!("{MATRIX}\nnan 0 1 2 -1 0 0 3 0 -1 0 1.5\n{MATRIX}\n"),
    );
    let kitti = kitti.unwrap();
    assert!(kitti.of("000001").is_none() && kitti.of("000002.png").is_some());
    assert_eq!(kitti.ignored(), 1);
}

#[test]
fn quaternions_are_normalised_or_refused() {
    let scratch = Scratch::new();
    // ROS rounds to four digits or more.
    let poses = scratch.read("a.txt", "1 2 3 1.5 -0.502 0.502 -0.502 0.502\n");
    assert_is_there(poses.unwrap().of("1"));
    for (text, what) in [
        (
            "1 0 0 0 0 0 0 2",
            "line 1 holds a quaternion of length 2.000",
        ),
        (
            "2 0 0 0 0 2 0 0 0 0 2 0",
            "line 1 has a pose whose first three columns are no rotation",
        ),
        (
            "-1 0 0 0 0 1 0 0 0 0 1 0",
            "line 1 has a pose that mirrors the world",
        ),
        ("1 2 3", "has 3 numbers in its first row"),
        ("# nothing", "holds no pose"),
        ("1 0 0 0 0 0 0 0", "all 1 rows are broken"),
    ] {
        let error = scratch.read("b.txt", text).unwrap_err().to_string();
        assert!(error.contains(what), "{error}");
    }
    let missing = Poses::open(&scratch.0.path().join("none.txt")).unwrap_err();
    assert_eq!(missing.cause(), crate::error::Cause::Read);
}
