use super::*;

/// A camera rotated by 90 degrees about its vertical axis: it looks along -x of the world.
const CAMERAS: &str = "# Camera list\n1 SIMPLE_RADIAL 640 480 500 320 240 0.01\n";
const IMAGES: &str = "# Image list with two lines of data per image:\n\
    7 0.70710678118654757 0 0.70710678118654757 0 0 0 3 1 a view.jpg\n\
    100.5 50.5 4 10 10 -1 200.25 300.75 5 320 240 6 1 1 99\n\
    8 1 0 0 0 0 0 0 1 empty.jpg\n\
    \n";
const POINTS: &str = "# 3D point list\n\
    4 -2 0 0 10 20 30 0.5 7 0 8 1 9 0\n\
    5 -1 1 2 10 20 30 0.1 7 2 8 1\n\
    6 4 0 0 10 20 30 0.5 7 3\n";

fn model(files: &[(&str, &[u8])]) -> Result<Colmap> {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in files {
        std::fs::write(folder.path().join(name), bytes).unwrap();
    }
    Colmap::read(folder.path())
}

fn as_text() -> Vec<(&'static str, Vec<u8>)> {
    [
        ("cameras.txt", CAMERAS),
        ("images.txt", IMAGES),
        ("points3D.txt", POINTS),
    ]
    .map(|(name, text)| (name, text.as_bytes().to_vec()))
    .to_vec()
}

/// The same model in the binary form, written by hand.
fn as_binary() -> Vec<(&'static str, Vec<u8>)> {
    let mut cameras = Vec::new();
    cameras.extend(1_u64.to_le_bytes());
    cameras.extend(1_u32.to_le_bytes());
    cameras.extend(2_u32.to_le_bytes());
    cameras.extend([640_u64, 480].map(u64::to_le_bytes).concat());
    cameras.extend([500.0, 320.0, 240.0, 0.01].map(f64::to_le_bytes).concat());

    let half = 0.5_f64.sqrt();
    let mut images = Vec::new();
    images.extend(2_u64.to_le_bytes());
    images.extend(7_u32.to_le_bytes());
    let pose = [half, 0.0, half, 0.0, 0.0, 0.0, 3.0];
    images.extend(pose.map(f64::to_le_bytes).concat());
    images.extend(1_u32.to_le_bytes());
    images.extend(b"a view.jpg\0");
    let seen = [
        (100.5, 50.5, 4),
        (10.0, 10.0, u64::MAX),
        (200.25, 300.75, 5),
        (320.0, 240.0, 6),
        (1.0, 1.0, 99),
    ];
    images.extend((seen.len() as u64).to_le_bytes());
    for (u, v, point) in seen {
        images.extend([u, v].map(f64::to_le_bytes).concat());
        images.extend(point.to_le_bytes());
    }
    images.extend(8_u32.to_le_bytes());
    let pose = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    images.extend(pose.map(f64::to_le_bytes).concat());
    images.extend(1_u32.to_le_bytes());
    images.extend(b"empty.jpg\0");
    images.extend(0_u64.to_le_bytes());

    let mut points = Vec::new();
    points.extend(3_u64.to_le_bytes());
    let landmarks = [
        (4_u64, [-2.0, 0.0, 0.0], 0.5, &[7_u32, 8, 9][..]),
        (5, [-1.0, 1.0, 2.0], 0.1, &[7, 8]),
        (6, [4.0, 0.0, 0.0], 0.5, &[7]),
    ];
    for (id, position, error, images) in landmarks {
        points.extend(id.to_le_bytes());
        points.extend(position.map(f64::to_le_bytes).concat());
        points.extend([10, 20, 30]);
        points.extend(f64::to_le_bytes(error));
        points.extend((images.len() as u64).to_le_bytes());
        for image in images {
            points.extend([*image, 0].map(u32::to_le_bytes).concat());
        }
    }
    vec![
        ("cameras.bin", cameras),
        ("images.bin", images),
        ("points3D.bin", points),
    ]
}

fn borrowed<'a>(files: &'a [(&'static str, Vec<u8>)]) -> Vec<(&'static str, &'a [u8])> {
    files.iter().map(|(n, b)| (*n, &b[..])).collect()
}

#[test]
fn depths_are_those_along_the_optical_axis() {
    for files in [as_text(), as_binary()] {
        let found = model(&borrowed(&files)).unwrap();
        let [view, empty] = &found.views[..] else {
            panic!("{} views", found.views.len());
        };
        assert_eq!((&view.name[..], view.size), ("a view.jpg", (640, 480)));
        // Depth is -x + 3: 5 and 4 in front of the camera, -1 behind it; 99 is unknown.
        let expected = [(100.0, 50.0, 5.0), (199.75, 300.25, 4.0)];
        assert_eq!((view.keypoints.len(), view.ignored), (2, 2));
        for (point, (u, v, depth)) in view.keypoints.iter().zip(expected) {
            assert_eq!((point.u, point.v), (u, v));
            assert!((point.depth - depth).abs() < 1e-12);
        }
        // The first point and both cameras lie on one line. The number is by numpy, as in the test of rigs.
        assert_eq!(view.keypoints[0].sigma, None);
        let sigma = view.keypoints[1].sigma.unwrap();
        assert!((sigma - 0.002_147_553).abs() < 1e-8, "{sigma}");
        assert_eq!((&empty.name[..], empty.keypoints.len()), ("empty.jpg", 0));
    }
}

#[test]
fn points_at_the_centre_of_a_camera_are_left_out() {
    let mut files = as_text();
    // Its depth is 1e-9, that of the others 5 and 4.
    files[2].1 = POINTS.replace("6 4 0 0", "6 2.999999999 0 0").into_bytes();
    let view = &model(&borrowed(&files)).unwrap().views[0];
    assert_eq!((view.keypoints.len(), view.ignored), (2, 2));
    assert!(view.keypoints.iter().all(|point| point.depth > 1.0));
}

#[test]
fn models_that_are_cut_off_or_promise_too_much_are_refused() {
    let whole = as_binary();
    for file in 0..3 {
        for length in 0..whole[file].1.len() {
            let mut cut = whole.clone();
            cut[file].1.truncate(length);
            assert!(model(&borrowed(&cut)).is_err(), "{file} {length}");
        }
        let mut many = whole.clone();
        many[file].1[..8].copy_from_slice(&(1_u64 << 40).to_le_bytes());
        let error = model(&borrowed(&many)).unwrap_err().to_string();
        assert!(error.contains("promises 1099511627776 entries"), "{error}");
    }
}

#[test]
fn what_is_wrong_with_a_text_is_said_with_its_line() {
    let wrong = |file: usize, from: &str, to: &str| {
        let mut files = as_text();
        let text = String::from_utf8(files[file].1.clone()).unwrap();
        files[file].1 = text.replace(from, to).into_bytes();
        model(&borrowed(&files)).unwrap_err().to_string()
    };
    let error = wrong(0, "640", "wide");
    assert!(
        error.contains("line 2: `wide` in the place of a width"),
        "{error}"
    );
    let error = wrong(1, "300.75 5", "300.75");
    assert!(error.contains("line 3"), "{error}");
    let error = wrong(1, "3 1 a", "3 2 a");
    assert!(error.contains("`a view.jpg` has no camera 2"), "{error}");
    let error = model(&[]).unwrap_err().to_string();
    assert!(
        error.contains("holds no cameras.bin or cameras.txt"),
        "{error}"
    );
}

/// A rig whose second camera is rotated by 30 degrees, in a frame rotated by 15, and an IMU; the file of images has other
/// poses. Depths and binary files are from pycolmap 4.2.
const RIG_CAMERAS: &str =
    "1 SIMPLE_RADIAL 640 480 500 320 240 0.01\n2 SIMPLE_RADIAL 640 480 500 320 240 0.01\n";
const RIG_IMAGES: &str = "7 1 0 0 0 0 0 0 1 left.jpg\n100.5 50.5 4\n\
    8 1 0 0 0 0 0 0 2 right.jpg\n200.25 300.75 5 10 20 4\n";
const RIG_POINTS: &str = "4 -2 0 4 10 20 30 0.5 7 0 8 1\n5 -1 1 5 10 20 30 0.1 8 0\n";
const RIGS: &str = "# Rig calib list with one line of data per calib:\n\
    3 3 CAMERA 1 CAMERA 2 1 0.9659258262890683 0 0.25881904510252074 0 0.1 0.2 -0.3 IMU 1 0\n";
const FRAMES: &str = "# Frame list with one line of data per frame:\n\
    1 3 0.9914448613738104 0.13052619222005157 0 0 0.5 -0.25 1.5 2 CAMERA 1 7 CAMERA 2 8\n";
const RIGS_BINARY: &str = "01000000000000000300000003000000000000000100000000000000020000000115bf4847dde8ee3f000000\
    0000000000900693c17d90d03f00000000000000009a9999999999b93f9a9999999999c93f333333333333d3bf010000000100000000";
const FRAMES_BINARY: &str = "010000000000000001000000030000009b68ec92eab9ef3fd0a26d0f15b5c03f000000000000000000000000\
    00000000000000000000e03f000000000000d0bf000000000000f83f0200000000000000010000000700000000000000000000000200000008\
    00000000000000";
const RIG_DEPTHS: [&[f64]; 2] = [
    &[5.363_703_305_156_273],
    &[5.655_763_492_407_711, 5.095_103_320_627_889_5],
];

fn unhex(text: &str) -> Vec<u8> {
    let digit = |i: usize| u8::from_str_radix(&text[i..i + 2], 16).unwrap();
    (0..text.len()).step_by(2).map(digit).collect()
}

fn rig() -> Vec<(&'static str, Vec<u8>)> {
    [
        ("cameras.txt", RIG_CAMERAS),
        ("images.txt", RIG_IMAGES),
        ("points3D.txt", RIG_POINTS),
        ("rigs.txt", RIGS),
        ("frames.txt", FRAMES),
    ]
    .map(|(name, text)| (name, text.as_bytes().to_vec()))
    .to_vec()
}

/// Images of [`RIG_IMAGES`] in binary form.
fn rig_in_binary() -> Vec<(&'static str, Vec<u8>)> {
    let mut images = 2_u64.to_le_bytes().to_vec();
    let seen: [&[(f64, f64, u64)]; 2] =
        [&[(100.5, 50.5, 4)], &[(200.25, 300.75, 5), (10.0, 20.0, 4)]];
    for (number, (name, seen)) in ["left.jpg\0", "right.jpg\0"]
        .into_iter()
        .zip(seen)
        .enumerate()
    {
        let number = number as u32;
        images.extend((7 + number).to_le_bytes());
        let pose = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        images.extend(pose.map(f64::to_le_bytes).concat());
        images.extend((1 + number).to_le_bytes());
        images.extend(name.as_bytes());
        images.extend((seen.len() as u64).to_le_bytes());
        for (u, v, point) in seen {
            images.extend([*u, *v].map(f64::to_le_bytes).concat());
            images.extend(point.to_le_bytes());
        }
    }
    let mut cameras = 2_u64.to_le_bytes().to_vec();
    for id in [1_u32, 2] {
        cameras.extend([id, 2].map(u32::to_le_bytes).concat());
        cameras.extend([640_u64, 480].map(u64::to_le_bytes).concat());
        cameras.extend([500.0, 320.0, 240.0, 0.01].map(f64::to_le_bytes).concat());
    }
    let mut points = 2_u64.to_le_bytes().to_vec();
    let landmarks = [
        (4_u64, [-2.0, 0.0, 4.0], &[7_u32, 8][..]),
        (5, [-1.0, 1.0, 5.0], &[8]),
    ];
    for (id, position, images) in landmarks {
        points.extend(id.to_le_bytes());
        points.extend(position.map(f64::to_le_bytes).concat());
        points.extend([10, 20, 30]);
        points.extend(0.5_f64.to_le_bytes());
        points.extend((images.len() as u64).to_le_bytes());
        for image in images {
            points.extend([*image, 0].map(u32::to_le_bytes).concat());
        }
    }
    vec![
        ("cameras.bin", cameras),
        ("images.bin", images),
        ("points3D.bin", points),
        ("rigs.bin", unhex(RIGS_BINARY)),
        ("frames.bin", unhex(FRAMES_BINARY)),
    ]
}

fn depths(model: &Colmap) -> Vec<Vec<f64>> {
    let of = |view: &View| view.keypoints.iter().map(|point| point.depth).collect();
    model.views.iter().map(of).collect()
}

#[test]
fn poses_of_frames_and_rigs_override_those_of_images() {
    for files in [rig(), rig_in_binary()] {
        let found = model(&borrowed(&files)).unwrap();
        for (found, expected) in depths(&found).iter().zip(RIG_DEPTHS) {
            assert_eq!(found.len(), expected.len());
            let deviation = found.iter().zip(expected).map(|(a, b)| (a - b).abs());
            assert!(
                deviation.fold(0.0, f64::max) < 1e-12,
                "{found:?} {expected:?}"
            );
        }
        let sigmas = [&found.views[0].keypoints[0], &found.views[1].keypoints[1]];
        for (point, expected) in sigmas.into_iter().zip([0.266_625_458, 0.265_856_373]) {
            let sigma = point.sigma.unwrap();
            assert!((sigma - expected).abs() < 1e-7, "{sigma} {expected}");
        }
        // The first camera is rotated by 15 degrees about x, and 1.60 away from the origin.
        for (view, words) in found
            .views
            .iter()
            .zip(["15.000 degrees and 1.6008", "degrees"])
        {
            let [remark] = &view.remarks[..] else {
                panic!("{:?}", view.remarks);
            };
            assert!(
                remark.contains("two poses") && remark.contains(words),
                "{remark}"
            );
        }
    }
}

#[test]
fn poses_that_agree_or_are_alone_are_not_remarked() {
    let mut files = as_text();
    let pose = "0.70710678118654757 0 0.70710678118654757 0 0 0 3";
    let frames = format!("1 1 {pose} 1 CAMERA 1 7\n2 1 1 0 0 0 0 0 0 1 CAMERA 1 8\n");
    let alone = model(&borrowed(&files)).unwrap();
    files.push(("rigs.txt", b"1 1 CAMERA 1\n".to_vec()));
    files.push(("frames.txt", frames.into_bytes()));
    let both = model(&borrowed(&files)).unwrap();
    assert_eq!(depths(&alone), depths(&both));
    let remarks = alone
        .views
        .iter()
        .chain(&both.views)
        .map(|view| view.remarks.len());
    assert_eq!(remarks.sum::<usize>(), 0);
    // Frames without an image, or without their rigs, leave the poses of images, which is reported.
    files.pop();
    let without = model(&borrowed(&files)).unwrap();
    assert!(without.views[0].remarks[0].contains("give no pose"));
    assert_eq!(depths(&alone), depths(&without));
}

#[test]
fn of_a_model_in_both_forms_the_binary_one_is_read_and_what_differs_is_said() {
    let mut files = as_binary();
    files.extend(as_text());
    let same = model(&borrowed(&files)).unwrap();
    assert!(same.views.iter().all(|view| view.remarks.is_empty()));
    let text = IMAGES.replace(" 3 1 a view", " 9 1 a view").into_bytes();
    files[4] = ("images.txt", text);
    let found = model(&borrowed(&files)).unwrap();
    assert_eq!(depths(&found), depths(&same));
    assert!(found.views[0].remarks[0].contains("images.bin is used, not that of images.txt"));
    assert!(found.views[1].remarks.is_empty());
    // An incomplete binary form is ignored if the text form exists.
    files.remove(2);
    let found = model(&borrowed(&files)).unwrap();
    assert_eq!(found.views[0].keypoints[0].depth, 11.0);
}

#[test]
fn rigs_and_frames_that_are_cut_off_are_refused() {
    let whole = rig_in_binary();
    for file in 3..5 {
        for length in 0..whole[file].1.len() {
            let mut cut = whole.clone();
            cut[file].1.truncate(length);
            assert!(model(&borrowed(&cut)).is_err(), "{file} {length}");
        }
    }
    let mut wrong = rig();
    wrong[4].1 = FRAMES.replace("CAMERA 1 7", "CAMERA one 7").into_bytes();
    let error = model(&borrowed(&wrong)).unwrap_err().to_string();
    assert!(
        error.contains("frames.txt") && error.contains("line 2: `one`"),
        "{error}"
    );
}

/// Pixels are from pycolmap 4.2 (`Camera.img_from_cam`), minus half a pixel.
#[test]
fn the_models_of_colmap_4_are_known() {
    for (camera, [u, v]) in [
        (
            "SIMPLE_FISHEYE 640 480 500 320 240",
            [463.964_225_350_545_7, 144.023_849_766_302_85],
        ),
        (
            "FISHEYE 640 480 500 510 320 240",
            [463.964_225_350_545_7, 142.104_326_761_628_9],
        ),
    ] {
        let mut files = as_text();
        files[0].1 = format!("1 {camera}\n").into_bytes();
        let found = model(&borrowed(&files)).unwrap();
        // The second image is at the origin.
        let seeing = found.views[1].camera.clone().unwrap();
        let (pixel, _) = seeing.project([0.6, -0.4, 2.0]).unwrap();
        let deviation = (pixel[0] + 0.5 - u).hypot(pixel[1] + 0.5 - v);
        assert!(deviation < 1e-9, "{camera}: {pixel:?}");
    }
    let mut files = as_text();
    files[0].1 = b"1 EUCM 640 480 500 510 320 240 0.5 1.1\n".to_vec();
    let found = model(&borrowed(&files)).unwrap();
    assert!(found.views[0].camera.is_none() && found.views[0].count() == 2);
    files[0].1 = b"1 EQUIRECTANGULAR 640 480 640 480\n".to_vec();
    let error = model(&borrowed(&files)).unwrap_err().to_string();
    assert!(error.contains("looks all around"), "{error}");
}

/// A camera of 64x48 pixels at the origin that sees twelve points, with keypoints scaled by `factor` about the corner.
fn seen(factor: f64) -> View {
    let position = |i: i32| (f64::from(i % 4) - 1.5, f64::from(i / 4) - 1.0, 4.0);
    let keypoint = |i| {
        let (x, y, z) = position(i);
        let (u, v) = (32.0 + 50.0 * x / z, 24.0 + 50.0 * y / z);
        format!("{} {} {i}", factor * u, factor * v)
    };
    let point = |i| {
        let (x, y, z) = position(i);
        format!("{i} {x} {y} {z} 0 0 0 0.5 1 {i}")
    };
    let keypoints = (0..12).map(keypoint).collect::<Vec<_>>().join(" ");
    let points = (0..12).map(point).collect::<Vec<_>>().join("\n");
    let images = format!("1 1 0 0 0 0 0 0 1 a.png\n{keypoints}\n");
    let files = [
        ("cameras.txt", "1 PINHOLE 64 48 50 50 32 24\n".as_bytes()),
        ("images.txt", images.as_bytes()),
        ("points3D.txt", points.as_bytes()),
    ];
    model(&files).unwrap().views.remove(0)
}

#[test]
fn keypoints_of_images_of_another_size_than_the_cameras_are_doubted() {
    assert_eq!(seen(1.0).remarks, Vec::<String>::new());
    let remarks = seen(2.0).remarks;
    assert!(
        remarks.len() == 1 && remarks[0].contains("pixels from where the camera"),
        "{remarks:?}"
    );
}

#[test]
fn a_pose_without_a_rotation_is_refused() {
    for pose in ["0 0 0 0 0 0 0", "nan 0 0 0 0 0 0", "1 0 0 0 inf 0 0"] {
        let images = format!("1 {pose} 1 a.png\n3 4 4\n");
        let mut files = as_text();
        files[1].1 = images.into_bytes();
        let files: Vec<_> = files
            .iter()
            .map(|(name, bytes)| (*name, &bytes[..]))
            .collect();
        let error = model(&files).unwrap_err().to_string();
        assert!(
            error.contains("no rotation") && error.contains("line 1"),
            "{error}"
        );
    }
}
