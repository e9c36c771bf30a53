use super::*;
use crate::Orientation;
use image::RgbImage;
use serde_json::Value;

/// Two images of 4x3 pixels, the second rotated by its EXIF record; the model and parameters of their cameras are given.
const IMAGES_TXT: &str = "\
    1 1 0 0 0 0 0 0 1 a.png\n1 1 1 3 2 2\n\
    2 1 0 0 0 -1 0 0 1 b/c.png\n2 2 1\n";
const POINTS_TXT: &str = "1 0 0 2 1 2 3 0.5 1 0 2 0\n2 0 0 4 1 2 3 0.5 1 1\n";

struct Scene {
    root: tempfile::TempDir,
    model: Colmap,
}

impl Scene {
    fn new(camera: &str, images: &str) -> Self {
        let root = tempfile::tempdir().unwrap();
        let at = |name: &str| root.path().join(name);
        std::fs::create_dir_all(at("model")).unwrap();
        std::fs::create_dir_all(at("photos/b")).unwrap();
        std::fs::write(at("model/cameras.txt"), format!("1 {camera}\n")).unwrap();
        std::fs::write(at("model/images.txt"), images).unwrap();
        std::fs::write(at("model/points3D.txt"), POINTS_TXT).unwrap();
        for name in ["a.png", "b/c.png"] {
            let picture = RgbImage::from_pixel(4, 3, image::Rgb([9, 8, 7]));
            crate::write_rgb(&at("photos").join(name), &picture).unwrap();
        }
        let model = Colmap::read(&at("model")).unwrap();
        Self { root, model }
    }

    fn pinhole() -> Self {
        Self::new("PINHOLE 4 3 5 5 2 1.5", IMAGES_TXT)
    }

    fn workspace(&self, tool: WorkspaceFormat) -> Result<Workspace> {
        let folder = self.root.path().join("out").join(tool.name());
        Workspace::new(tool, folder, &self.root.path().join("model"), &self.model)
    }

    fn add(
        &self,
        workspace: &Workspace,
        name: &str,
        depth: &DepthMap,
        replace: bool,
    ) -> Result<()> {
        let frame = workspace.encode(name, depth, None)?;
        workspace.write(&frame, &self.root.path().join("photos").join(name), replace)
    }
}

fn depth(value: f32) -> DepthMap {
    DepthMap::new(4, 3, vec![value; 12]).unwrap()
}

#[test]
fn a_workspace_lists_the_images_that_it_has() {
    let scene = Scene::pinhole();
    for tool in WorkspaceFormat::ALL {
        let workspace = scene.workspace(tool).unwrap();
        workspace.create(false).unwrap();
        let text = |name: &str| std::fs::read_to_string(workspace.folder().join(name));
        assert!(!workspace.has_any("a.png") && !workspace.has("a.png"));
        scene
            .add(&workspace, "b/c.png", &depth(2.0), false)
            .unwrap();
        assert!(workspace.has("b/c.png") && !workspace.has("a.png"));
        let finished = workspace.finish().unwrap();
        assert_eq!((finished.with_depth, finished.without_depth), (1, 1));
        scene.add(&workspace, "a.png", &depth(2.5), false).unwrap();
        let finished = workspace.finish().unwrap();
        assert_eq!((finished.with_depth, finished.without_depth), (2, 0));
        for name in ["a.png", "b/c.png"] {
            let copy = workspace.folder().join("images").join(name);
            let photo = scene.root.path().join("photos").join(name);
            assert_eq!(std::fs::read(copy).unwrap(), std::fs::read(photo).unwrap());
        }
        match tool {
            WorkspaceFormat::Colmap => {
                assert_eq!(text("sparse/images.txt").unwrap(), IMAGES_TXT);
                assert_eq!(text("stereo/fusion.cfg").unwrap(), "a.png\nb/c.png\n");
                let maps = workspace.folder().join("stereo/depth_maps/b");
                let map = std::fs::read(maps.join("c.png.geometric.bin")).unwrap();
                assert_eq!(map.len(), 6 + 4 * 12);
            }
            WorkspaceFormat::Splatting => {
                assert_eq!(text("sparse/0/points3D.txt").unwrap(), POINTS_TXT);
                let text = text("sparse/0/depth_params.json").unwrap();
                let parameters: Value = serde_json::from_str(&text).unwrap();
                // The nearest point is at 2: a quarter of it is the nearest depth that can be stored.
                assert_eq!(parameters["a"]["scale"], 2.0);
                assert_eq!(parameters["b/c"]["offset"], 0.0);
                let (_, kind) =
                    crate::files::image_kind(&workspace.folder().join("depths/b/c.png")).unwrap();
                assert_eq!(kind, image::ColorType::L16);
            }
            WorkspaceFormat::Nerfstudio => {
                let found: Value = serde_json::from_str(&text("transforms.json").unwrap()).unwrap();
                let frame = &found["frames"][1];
                assert_eq!(frame["depth_file_path"], "depths/b/c.png.png");
                // The centre of the camera is at x = 1.
                assert_eq!(frame["transform_matrix"][0][3], 1.0);
                let map = workspace.folder().join("depths/b/c.png.png");
                assert_eq!(crate::read_depth_png(&map, 1e-3).unwrap(), depth(2.0));
            }
        }
    }
}

#[test]
fn nothing_else_is_replaced_unasked() {
    let scene = Scene::pinhole();
    for tool in WorkspaceFormat::ALL {
        let workspace = scene.workspace(tool).unwrap();
        // A folder of other contents.
        std::fs::create_dir_all(workspace.folder()).unwrap();
        std::fs::write(workspace.folder().join("mine.txt"), "1").unwrap();
        let error = workspace.create(false).unwrap_err();
        assert!(error.to_string().contains("is no workspace"), "{error}");
        workspace.create(true).unwrap();
        workspace.create(false).unwrap();
        scene.add(&workspace, "a.png", &depth(2.0), false).unwrap();
        // Equal files may be written again, other depths may not.
        scene.add(&workspace, "a.png", &depth(2.0), false).unwrap();
        let error = scene.add(&workspace, "a.png", &depth(3.0), false);
        assert!(error.unwrap_err().to_string().ends_with("exists"), "{tool}");
        let before = workspace.encode("a.png", &depth(2.0), None).unwrap().files;
        for (path, bytes) in &before {
            let found = std::fs::read(workspace.folder().join(path)).unwrap();
            assert_eq!(&found, bytes, "{tool}");
        }
        scene.add(&workspace, "a.png", &depth(3.0), true).unwrap();
    }
}

#[test]
fn no_depth_stays_none() {
    let scene = Scene::pinhole();
    let mut values = vec![2.0; 12];
    values[6] = 0.0;
    let map = DepthMap::new(4, 3, values).unwrap();
    for tool in WorkspaceFormat::ALL {
        let workspace = scene.workspace(tool).unwrap();
        let frame = workspace.encode("a.png", &map, None).unwrap();
        assert_eq!(frame.counts.empty, 1);
        let (_, bytes) = &frame.files[0];
        let values: Vec<f32> = if tool == WorkspaceFormat::Colmap {
            let (floats, _) = bytes[6..].as_chunks::<4>();
            floats.iter().copied().map(f32::from_le_bytes).collect()
        } else {
            let picture = image::load_from_memory(bytes).unwrap().into_luma16();
            picture.into_raw().into_iter().map(f32::from).collect()
        };
        let zeros: Vec<usize> = (0..12).filter(|i| values[*i] == 0.0).collect();
        assert_eq!(zeros, [6], "{tool}");
    }
}

/// nerfstudio's rays of fisheye lenses have length 1, so its depths are distances along them. In an equidistant lens, a
/// pixel at a distance r from the centre has a ray at r / f radians from the axis.
#[test]
fn depths_of_fisheye_lenses_are_distances() {
    let scene = Scene::new("OPENCV_FISHEYE 4 3 5 5 2 1.5 0 0 0 0", IMAGES_TXT);
    let workspace = scene.workspace(WorkspaceFormat::Nerfstudio).unwrap();
    workspace.create(false).unwrap();
    scene.add(&workspace, "a.png", &depth(2.0), false).unwrap();
    let stored = crate::read_depth_png(&workspace.folder().join("depths/a.png.png"), 0.001);
    let stored = stored.unwrap();
    for y in 0..3 {
        for x in 0..4 {
            let away = [x as f64 - 1.5, y as f64 - 1.0].map(|v| v / 5.0);
            let angle = away[0].hypot(away[1]);
            let expected = 2.0 / angle.cos();
            assert!(
                (f64::from(stored.at(x, y)) - expected).abs() < 6e-4,
                "{x} {y}"
            );
        }
    }
}

#[test]
fn maps_are_turned_back_to_the_stored_pixels() {
    let scene = Scene::pinhole();
    // Stored 4x3, upright 3x4, rotated by 90 degrees clockwise.
    let orientation = Orientation::new((4, 3), 6);
    let camera = scene.model.views[0].camera_of(&orientation, None).unwrap();
    let stored: Vec<f32> = (1..=12).map(|v| v as f32).collect();
    let shown = |i: usize| {
        let (x, y) = (i % 3, i / 3);
        stored[(2 - x) * 4 + y]
    };
    let shown = DepthMap::new(3, 4, (0..12).map(shown).collect()).unwrap();
    let workspace = scene.workspace(WorkspaceFormat::Colmap).unwrap();
    let frame = workspace.encode("a.png", &shown, camera.as_ref()).unwrap();
    let bytes = &frame.files[0].1;
    assert!(bytes.starts_with(b"4&3&1&"));
    let (floats, _) = bytes[6..].as_chunks::<4>();
    let found: Vec<f32> = floats.iter().copied().map(f32::from_le_bytes).collect();
    assert_eq!(found, stored);
}

#[test]
fn what_a_program_cannot_use_is_refused() {
    let refused = |camera: &str, images: &str, tool: WorkspaceFormat, words: &str| {
        let error = Scene::new(camera, images).workspace(tool).unwrap_err();
        assert!(error.to_string().contains(words), "{tool}: {error}");
        error
    };
    let opencv = "OPENCV 4 3 5 5 2 1.5 0.1 0 0 0";
    for tool in [WorkspaceFormat::Colmap, WorkspaceFormat::Splatting] {
        let error = refused(opencv, IMAGES_TXT, tool, "has distortion (radtan)");
        assert!(error.advice().unwrap().contains("image_undistorter"));
    }
    let full = "FULL_OPENCV 4 3 5 5 2 1.5 0.1 0 0 0 0 0.2 0 0";
    refused(
        full,
        IMAGES_TXT,
        WorkspaceFormat::Nerfstudio,
        "has distortion",
    );
    let fov = "FOV 4 3 5 5 2 1.5 0.1";
    refused(
        fov,
        IMAGES_TXT,
        WorkspaceFormat::Nerfstudio,
        "is not supported",
    );
    let twins = "1 1 0 0 0 0 0 0 1 a.png\n1 1 1\n2 1 0 0 0 0 0 0 1 a.jpg\n\n";
    refused(
        "PINHOLE 4 3 5 5 2 1.5",
        twins,
        WorkspaceFormat::Splatting,
        "called `a`",
    );
    let blind = "1 1 0 0 0 0 0 0 1 a.png\n\n";
    refused(
        "PINHOLE 4 3 5 5 2 1.5",
        blind,
        WorkspaceFormat::Splatting,
        "sees a point",
    );
    assert!(
        Scene::new(opencv, IMAGES_TXT)
            .workspace(WorkspaceFormat::Nerfstudio)
            .is_ok()
    );
}

#[test]
fn images_that_are_not_those_of_the_model_are_refused() {
    let outside = "1 1 0 0 0 0 0 0 1 ../a.png\n1 1 1\n";
    let scene = Scene::new("PINHOLE 4 3 5 5 2 1.5", outside);
    let workspace = scene.workspace(WorkspaceFormat::Colmap).unwrap();
    let error = workspace.encode("../a.png", &depth(2.0), None).unwrap_err();
    assert!(error.to_string().contains("leads out"), "{error}");
    let scene = Scene::new("PINHOLE 8 6 5 5 4 3", IMAGES_TXT);
    let workspace = scene.workspace(WorkspaceFormat::Colmap).unwrap();
    let error = scene.add(&workspace, "a.png", &depth(2.0), false);
    let error = error.unwrap_err().to_string();
    assert!(error.contains("is 4x3, but 8x6 in the model"), "{error}");
    assert!(workspace.encode("other.png", &depth(2.0), None).is_err());
}
