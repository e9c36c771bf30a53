use super::*;

/// A camera turned by 90 degrees about its vertical axis: it looks along -x of the world.
const CAMERAS: &str = "# Camera list\n1 SIMPLE_RADIAL 640 480 500 320 240 0.01\n";
const IMAGES: &str = "# Image list with two lines of data per image:\n\
    7 0.70710678118654757 0 0.70710678118654757 0 0 0 3 1 a view.jpg\n\
    100.5 50.5 4 10 10 -1 200.25 300.75 5 320 240 6 1 1 99\n\
    8 1 0 0 0 0 0 0 1 empty.jpg\n\
    \n";
const POINTS: &str = "# 3D point list\n\
    4 -2 0 0 10 20 30 0.5 7 0 8 1 9 0\n\
    5 -1 1 2 10 20 30 0.1 7 2\n\
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
        (4_u64, [-2.0, 0.0, 0.0], 0.5, 3_u64),
        (5, [-1.0, 1.0, 2.0], 0.1, 1),
        (6, [4.0, 0.0, 0.0], 0.5, 1),
    ];
    for (id, place, error, track) in landmarks {
        points.extend(id.to_le_bytes());
        points.extend(place.map(f64::to_le_bytes).concat());
        points.extend([10, 20, 30]);
        points.extend(f64::to_le_bytes(error));
        points.extend(track.to_le_bytes());
        points.extend(vec![0; 8 * track as usize]);
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
        // Along the axis lies -x + 3: 5 and 4 before the camera, -1 behind it; 99 is unknown.
        let expected = [(100.0, 50.0, 5.0), (199.75, 300.25, 4.0)];
        assert_eq!((view.keypoints.len(), view.ignored), (2, 2));
        for (point, (u, v, depth)) in view.keypoints.iter().zip(expected) {
            assert_eq!((point.u, point.v), (u, v));
            assert!((point.depth - depth).abs() < 1e-12);
        }
        // 5 m x 0.5 pixels / (500 pixels x sqrt(3 - 1)); errors count as 0.3 at least.
        let sigma = |i: usize| view.keypoints[i].sigma;
        assert!((sigma(0) - 0.005 / 2_f64.sqrt()).abs() < 1e-12);
        assert!((sigma(1) - 4.0 * 0.3 / 500.0).abs() < 1e-12);
        assert_eq!((&empty.name[..], empty.keypoints.len()), ("empty.jpg", 0));
    }
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
