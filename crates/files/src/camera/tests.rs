use super::stored::CameraFile;
use super::*;

fn stored(text: &str) -> std::result::Result<Camera, String> {
    let stored: CameraFile = toml::from_str(text).map_err(|e| e.to_string())?;
    Camera::try_from(stored)
}

const RADTAN: &str = "fx = 500\nfy = 510\ncx = 320\ncy = 240\nmodel = 'radtan'\n\
    distortion = [-0.28, 0.07, 0.0002, 0.00002, 0.0]\n";
const FISHEYE: &str = "fx = 380\nfy = 380\ncx = 319.5\ncy = 239.5\nmodel = 'fisheye'\n\
    distortion = [-0.01, 0.02, -0.015, 0.003]\n";

/// Results of cv2.projectPoints and cv2.fisheye.projectPoints (OpenCV 5.0).
#[test]
fn points_appear_where_opencv_says() {
    for (text, expected) in [(RADTAN, OPENCV_RADTAN), (FISHEYE, OPENCV_FISHEYE)] {
        let camera = stored(text).unwrap();
        for (point, pixel) in POINTS.into_iter().zip(expected) {
            let (found, depth) = camera.project(point).unwrap();
            assert_eq!(depth, point[2]);
            for axis in 0..2 {
                assert!(
                    (found[axis] - pixel[axis]).abs() < 1e-6,
                    "{found:?} {pixel:?}"
                );
            }
        }
    }
}

const POINTS: [[f64; 3]; 3] = [[0.3, -0.2, 1.5], [-1.0, 0.7, 2.0], [0.0, 0.0, 3.0]];
const OPENCV_RADTAN: [[f64; 2]; 3] = [
    [418.401_634_567_901_2, 173.093_174_716_049_4],
    [93.620_490_625, 401.675_624_343_75],
    [320.0, 240.0],
];
const OPENCV_FISHEYE: [[f64; 2]; 3] = [
    [394.047_958_355_071_96, 189.801_361_096_618_68],
    [149.179_457_827_459_34, 358.724_379_521_836_85],
    [319.5, 239.5],
];

#[test]
fn pixels_lie_where_points_were() {
    let turned = "camera_to_world = [[0,0,1,2],[-1,0,0,3],[0,-1,0,1.5]]\n";
    for text in [RADTAN, FISHEYE] {
        let camera = stored(&format!("{text}{turned}")).unwrap();
        for [x, y] in [[0.0, 0.0], [100.0, 400.0], [639.0, 479.0]] {
            let point = camera.unproject([x, y], 2.5).unwrap();
            let ([u, v], depth) = camera.project(point).unwrap();
            assert!((u - x).abs() + (v - y).abs() < 1e-5, "{u} {v}");
            assert!((depth - 2.5).abs() < 1e-12);
        }
    }
}

#[test]
fn poses_lead_from_the_world() {
    // The camera is at (2, 3, 1.5) and looks along the world's x axis; the world's z axis is up.
    let camera = stored(
        "fx = 100\nfy = 100\ncx = 50\ncy = 40\n\
         camera_to_world = [[0,0,1,2],[-1,0,0,3],[0,-1,0,1.5],[0,0,0,1]]\n",
    )
    .unwrap();
    let (pixel, depth) = camera.project([6.0, 2.0, 2.5]).unwrap();
    assert!((depth - 4.0).abs() < 1e-12);
    assert!((pixel[0] - 75.0).abs() < 1e-9 && (pixel[1] - 15.0).abs() < 1e-9);
    assert!(camera.project([1.0, 3.0, 1.5]).is_none(), "behind it");
}

/// r (1 + k r^2) increases up to r = 1 / sqrt(-3 k), here 1.091.
#[test]
fn beyond_the_fold_nothing_is_seen() {
    let lens = "model = 'radtan'\ndistortion = [-0.28, 0.0, 0.0, 0.0]";
    let camera = stored(&format!("fx = 500\nfy = 500\ncx = 0\ncy = 0\n{lens}")).unwrap();
    for (x, seen) in [(0.5, true), (1.07, true), (1.11, false), (5.0, false)] {
        assert_eq!(camera.project([x, 0.0, 1.0]).is_some(), seen, "{x}");
    }
}

#[test]
fn another_size_is_the_same_view() {
    let camera = stored(&format!("{RADTAN}width = 640\nheight = 480\n")).unwrap();
    let half = camera.resized((320, 240)).unwrap();
    let [full, half] = [camera, half].map(|c| c.project([0.3, -0.2, 1.5]).unwrap().0);
    for axis in 0..2 {
        assert!((0.5 * (full[axis] + 0.5) - 0.5 - half[axis]).abs() < 1e-9);
    }
}

#[test]
fn what_is_no_camera_is_refused() {
    for (text, what) in [
        ("fx = 1\nfy = 1\ncx = 0", "needs fx"),
        ("fx = 0\nfy = 1\ncx = 0\ncy = 0", "cannot have fx 0"),
        (
            "fx = 1\nfy = 1\ncx = 0\ncy = 0\ndistortion = [1.0]",
            "radtan or fisheye",
        ),
        (
            "fx = 1\nfy = 1\ncx = 0\ncy = 0\nwidth = 3",
            "both width and height",
        ),
        (
            "fx = 1\nfy = 1\ncx = 0\ncy = 0\nworld_to_camera = [[2,0,0,0],[0,1,0,0],[0,0,1,0]]",
            "no rotation",
        ),
        ("fx = 1\nfy = 1\ncx = 0\ncy = 0\nk1 = 3", "unknown field"),
    ] {
        let error = stored(text).unwrap_err();
        assert!(error.contains(what), "{error}");
    }
}

#[test]
fn a_camera_of_another_shape_is_refused() {
    let camera = stored(&format!("{RADTAN}width = 640\nheight = 480\n")).unwrap();
    for size in [(480, 480), (640, 477), (480, 640)] {
        let error = camera.resized(size).unwrap_err();
        assert!(error.to_string().contains("640x480"), "{error}");
        assert!(error.advice().is_some());
        assert!(camera.for_image(&size.into()).is_err());
    }
    // Sizes are rounded to whole pixels.
    assert!(camera.resized((1000, 751)).is_ok());
}

/// The reference is the rotation of the pixels by the image library: `orientation.rs`.
#[test]
fn a_camera_is_turned_with_the_image_in_all_eight_orientations() {
    let sized = format!("{RADTAN}width = 640\nheight = 480\n");
    let point = [0.3, -0.2, 1.5];
    for text in [&sized[..], RADTAN] {
        let camera = stored(text).unwrap();
        let stored_place = camera.project(point).unwrap().0;
        for exif in 1..=8 {
            let image = Orientation::new((640, 480), exif);
            let (turned, text) = camera.for_image(&image).unwrap();
            assert_eq!(text.is_some(), exif > 1);
            let (position, depth) = turned.project(point).unwrap();
            assert_eq!(position, image.turned(stored_place), "{exif}");
            let found = turned.unproject(position, depth).unwrap();
            for axis in 0..3 {
                assert!((found[axis] - point[axis]).abs() < 1e-8, "{exif}");
            }
            // Half the size has the same view.
            let (width, height) = image.upright();
            let half = turned.resized((width / 2, height / 2)).unwrap();
            let small = half.project(point).unwrap().0;
            for axis in 0..2 {
                assert!((0.5 * (position[axis] + 0.5) - 0.5 - small[axis]).abs() < 1e-9);
            }
        }
    }
}

#[test]
fn a_principal_point_outside_the_image_is_doubted() {
    let warning = |center, image: Orientation| {
        let camera = Camera::pinhole([500.0; 2], center);
        camera.for_image(&image).unwrap().0.warnings().pop()
    };
    let image = || Orientation::from((640, 480));
    assert_eq!(warning([319.5, 239.5], image()), None);
    let text = warning([239.5, 500.0], image()).unwrap();
    assert!(
        text.contains("239.5, 500") && text.contains("640x480"),
        "{text}"
    );
    // The camera of an image that is stored rotated is that of the stored pixels.
    assert_eq!(
        warning([500.0, 239.5], Orientation::new((640, 480), 6)),
        None
    );
}

#[test]
fn a_camera_of_the_upright_image_stays() {
    let camera = stored(&format!("{RADTAN}width = 640\nheight = 480\n")).unwrap();
    let image = Orientation::new((480, 640), 6);
    let (same, text) = camera.for_image(&image).unwrap();
    assert_eq!(same, camera);
    assert!(text.is_some_and(|text| text.contains("upright image")));
}

/// theta + k theta^3 increases up to theta = 1 / sqrt(-3 k), here 0.9129.
#[test]
fn beyond_the_fold_a_fisheye_sees_nothing() {
    let lens = "model = 'fisheye'\ndistortion = [-0.4, 0.0, 0.0, 0.0]";
    let camera = stored(&format!("fx = 500\nfy = 500\ncx = 0\ncy = 0\n{lens}")).unwrap();
    for (angle, seen) in [(0.5_f64, true), (0.9, true), (0.93, false), (1.5, false)] {
        let found = camera.project([angle.tan(), 0.0, 1.0]);
        assert_eq!(found.is_some(), seen, "{angle}");
    }
}

#[test]
fn mirrors_are_no_poses() {
    let text = "fx = 1\nfy = 1\ncx = 0\ncy = 0\n\
        world_to_camera = [[-1,0,0,0],[0,1,0,0],[0,0,1,0]]";
    let error = stored(text).unwrap_err();
    assert!(error.contains("mirrors"), "{error}");
}

const CALIBRATED: &str = "image_width: 640\nimage_height: 480\ncamera_name: left\n\
    camera_matrix:\n  rows: 3\n  cols: 3\n  data: [500., 0., 320., 0., 510., 240., 0., 0., 1.]\n\
    distortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n\
    \x20 data: [-0.28, 0.07,\n    0.0002, 0.00002, 0.0]\nrectification_matrix:\n  rows: 3\n\
    \x20 cols: 3\n  data: [1., 0., 0., 0., 1., 0., 0., 0., 1.]\n";
const ECHOED: &str = "header:\n  seq: 3\n  frame_id: \"left\"\nheight: 480\nwidth: 640\n\
    distortion_model: \"plumb_bob\"\nd:\n- -0.28\n- 0.07\n- 0.0002\n- 0.00002\n- 0.0\n\
    k: [500.0, 0.0, 320.0, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0]\nroi:\n  height: 0\n  width: 0\n---\n";

#[test]
fn the_camera_info_of_ros_is_read() {
    let expected = stored(&format!("{RADTAN}width = 640\nheight = 480\n")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("left.yaml");
    for text in [CALIBRATED, ECHOED] {
        std::fs::write(&path, text).unwrap();
        assert_eq!(Camera::read(&path).unwrap(), expected);
    }
    for (from, to, what) in [
        ("500.", "wide", "`wide` is not a number"),
        ("plumb_bob", "mirror_ball", "`mirror_ball`"),
        ("camera_matrix", "matrix", "no camera_matrix"),
    ] {
        std::fs::write(&path, CALIBRATED.replace(from, to)).unwrap();
        let error = Camera::read(&path).unwrap_err().to_string();
        assert!(error.contains(what), "{error}");
    }
}

#[test]
fn a_window_or_a_binning_of_the_sensor_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("left.yaml");
    let read = |binning: usize, roi: [usize; 4]| {
        let [x, y, height, width] = roi;
        let whole = ECHOED.split("roi:").next().unwrap();
        let text = format!(
            "{whole}binning_x: {binning}\nbinning_y: {binning}\nroi:\n  x_offset: {x}\n  \
             y_offset: {y}\n  height: {height}\n  width: {width}\n  do_rectify: false\n---\n"
        );
        std::fs::write(&path, text).unwrap();
        Camera::read(&path)
    };
    for roi in [[0; 4], [0, 0, 480, 640]] {
        for binning in [0, 1] {
            assert!(read(binning, roi).is_ok(), "{binning} {roi:?}");
        }
    }
    for (binning, roi, what) in [
        (2, [0; 4], "binning_x 2"),
        (0, [64, 0, 480, 512], "roi.x_offset 64"),
        (0, [0, 32, 448, 640], "roi.y_offset 32"),
        (0, [0, 0, 480, 512], "roi.width 512"),
        (1, [0, 0, 240, 640], "roi.height 240"),
    ] {
        let error = read(binning, roi).unwrap_err();
        assert!(error.to_string().contains(what), "{error}");
        assert!(error.advice().is_some());
    }
}

/// Reads a YAML file.
fn yaml(text: &str) -> Result<Camera> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("camera.yml");
    std::fs::write(&path, text).unwrap();
    Camera::read(&path)
}

/// Written by `cv2.FileStorage` in the calibration program of OpenCV (`samples/cpp/tutorial_code/calib3d`).
const STORAGE: &str = "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\nfisheye_model: 1\n\
    camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 380., 0., 319.5, 0., 380., 239.5,\n\
    \x20      0., 0., 1. ]\ndistortion_coefficients: !!opencv-matrix\n   rows: 4\n   cols: 1\n   dt: d\n\
    \x20  data: [ -0.01, 0.02, -0.015, 0.003 ]\n";

#[test]
fn the_lens_of_a_calibration_by_opencv_is_what_its_flag_says() {
    let fisheye = yaml(STORAGE).unwrap();
    for (point, pixel) in POINTS.into_iter().zip(OPENCV_FISHEYE) {
        let (found, _) = fisheye.project(point).unwrap();
        let deviation = (found[0] - pixel[0]).hypot(found[1] - pixel[1]);
        assert!(deviation < 1e-6, "{found:?} {pixel:?}");
    }
    assert_eq!(fisheye.warnings(), Vec::<String>::new());
    let flagged = yaml(&STORAGE.replace("fisheye_model: 1", "fisheye_model: 0")).unwrap();
    assert!(flagged.to_string().contains("radtan"), "{flagged}");
    assert_eq!(flagged.warnings(), Vec::<String>::new());
    // Neither a flag nor a name.
    let unnamed = yaml(&STORAGE.replace("fisheye_model: 1\n", "")).unwrap();
    let warnings = unnamed.warnings();
    assert!(
        warnings.len() == 1 && warnings[0].contains("names no distortion model"),
        "{warnings:?}"
    );
    assert!(warnings[0].contains("fisheye"), "{warnings:?}");
    assert!(yaml(&STORAGE.replace("fisheye_model: 1", "fisheye_model: 2")).is_err());
}

/// r = f theta (Kannala and Brandt with all coefficients 0): 45 degrees are 380 pi / 4 pixels, not 380.
#[test]
fn a_fisheye_without_coefficients_is_no_pinhole() {
    let zeros = STORAGE.replace("-0.01, 0.02, -0.015, 0.003", "0., 0., 0., 0.");
    let ([u, v], _) = yaml(&zeros).unwrap().project([1.0, 0.0, 1.0]).unwrap();
    assert!((u - 319.5 - 380.0 * std::f64::consts::FRAC_PI_4).abs() < 1e-9 && v == 239.5);
}

#[test]
fn what_a_camera_info_assumes_of_rectification_is_said() {
    let with = |p: &str, r: &str| {
        let r = CALIBRATED.replace("rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1., 0., 0., 0., 1., 0., 0., 0., 1.]", r);
        yaml(&format!(
            "{r}projection_matrix:\n  rows: 3\n  cols: 4\n  data: [{p}]\n"
        ))
    };
    let warnings = |p: &str| with(p, "").unwrap().warnings();
    let text = warnings("400., 0., 310., 0., 0., 400., 240., 0., 0., 0., 1., 0.");
    assert!(
        text.len() == 1 && text[0].contains("taken for unrectified"),
        "{text:?}"
    );
    assert!(
        text[0].contains("P (fx 400, cx 310) differs from K (fx 500, cx 320)"),
        "{text:?}"
    );
    let text = warnings("500., 0., 320., -60., 0., 510., 240., 0., 0., 0., 1., 0.");
    assert!(
        text.len() == 1 && text[0].contains("stereo baseline of 0.1200 m"),
        "{text:?}"
    );
    let text = warnings("500., 0., 320., 0., 0., 510., 240., 0., 0., 0., 1., 0.");
    assert!(
        text.len() == 1 && text[0].contains("taken for unrectified"),
        "{text:?}"
    );
    let turned = "rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1., 0., 0., 0., 0., -1., 0., 1., 0.]";
    let text = with(
        "500., 0., 320., 0., 0., 510., 240., 0., 0., 0., 1., 0.",
        turned,
    );
    let text = text.unwrap().warnings();
    assert!(
        text[0].contains("R is a rotation of 90.00 degrees"),
        "{text:?}"
    );
}

#[test]
fn matrices_that_are_no_intrinsics_are_refused() {
    for (data, what) in [
        ("0., 0., 0., 0., 0., 0., 0., 0., 0.", "not calibrated"),
        ("500., 0., 0., 0., 510., 0., 320., 240., 1.", "transposed"),
        ("500., 3., 320., 0., 510., 240., 0., 0., 1.", "skew of 3"),
    ] {
        let text = CALIBRATED.replace("500., 0., 320., 0., 510., 240., 0., 0., 1.", data);
        let error = yaml(&text).unwrap_err().to_string();
        assert!(error.contains(what), "{error}");
    }
    // Row by row, where Open3D writes column by column.
    let text = "intrinsic_matrix = [500.0, 0.0, 320.0, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0]";
    assert!(stored(text).unwrap_err().contains("transposed"));
    let text = "intrinsic_matrix = [500.0, 0.0, 0.0, 0.0, 510.0, 0.0, 320.0, 240.0, 1.0]";
    assert_eq!(
        stored(text).unwrap().intrinsics(),
        [500.0, 510.0, 320.0, 240.0]
    );
}

#[test]
fn calibrations_of_other_programs_are_named() {
    let folder = tempfile::tempdir().unwrap();
    for (name, text, kind) in [
        (
            "transforms.json",
            "{\"fl_x\": 500, \"frames\": []}",
            "nerfstudio",
        ),
        (
            "camchain.yaml",
            "cam0:\n  camera_model: pinhole\n  distortion_coeffs: [0.1, 0, 0, 0]\n",
            "Kalibr",
        ),
        (
            "camera.xml",
            "<?xml version=\"1.0\"?>\n<opencv_storage>\n</opencv_storage>\n",
            "XML of OpenCV",
        ),
        (
            "view.json",
            "{\"class_name\": \"PinholeCameraParameters\"}",
            "Open3D",
        ),
        ("rs.json", "{\"width\": 640, \"ppx\": 320}", "librealsense"),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        let error = Camera::read(&path).unwrap_err();
        assert!(error.to_string().contains(kind), "{error}");
        assert!(error.advice().unwrap().contains("TOML"), "{error}");
    }
}

#[test]
fn a_camera_that_is_scaled_to_the_image_says_so() {
    let camera = stored(&format!("{RADTAN}width = 640\nheight = 480\n")).unwrap();
    let (half, _) = camera.for_image(&(320, 240).into()).unwrap();
    assert!(
        half.warnings()[0].contains("640x480 is scaled to 320x240"),
        "{:?}",
        half.warnings()
    );
    let (same, _) = camera.for_image(&(640, 480).into()).unwrap();
    assert_eq!(same.warnings(), Vec::<String>::new());
}
