//! Point clouds projected through every lens.

use crate::camera::{Camera, Sight};
use crate::files::{CLOUDS, write_camera, write_cloud};
use crate::observed::observed;
use crate::scene::Scene;
use crate::spread;
use crate::vector::{Vector, along};
use lsdc_eval::data::{self, Sparse};

/// Returns points of the scene at positions between pixels.
fn visible(scene: &Scene, camera: &Camera, count: usize) -> Vec<Vector> {
    let (width, height) = camera.size;
    let place = |i| {
        let [a, b] = spread(i);
        [a * width as f64 - 0.5, b * height as f64 - 0.5]
    };
    (0..count).map(|i| scene.point(camera, place(i))).collect()
}

/// Returns points in all directions around a camera, outside its image.
fn around(scene: &Scene, camera: &Camera, directions: usize) -> Vec<Vector> {
    let point = |i| {
        let [a, b] = spread(i);
        let (up, (sin, cos)) = (2.0 * a - 1.0, (std::f64::consts::TAU * b).sin_cos());
        let across = (1.0 - up * up).sqrt();
        scene
            .meets(camera.position, [across * cos, across * sin, up])
            .unwrap()
    };
    let points = (0..directions).map(point);
    points
        .filter(|&point| camera.see_inside(point).is_none())
        .collect()
}

#[test]
fn clouds_are_where_each_camera_sees_them() {
    let folder = tempfile::tempdir().unwrap();
    let scene = Scene::room();
    for (name, camera) in Camera::each() {
        let inside = visible(&scene, &camera, 1500);
        let beside = around(&scene, &camera, 500);
        assert!(beside.len() > 100, "{name}: {}", beside.len());
        let points = [&inside[..], &beside, &[[f64::NAN, 0.0, 0.0]]].concat();
        let truth: Vec<Sight> = inside
            .iter()
            .map(|&p| camera.see_inside(p).unwrap())
            .collect();
        let read = data::Camera::read(&write_camera(folder.path(), &camera)).unwrap();
        for form in CLOUDS {
            let path = write_cloud(folder.path(), form, &points);
            let sparse = Sparse::read(&path, None, Some(&read), camera.size).unwrap();
            let stayed = observed(&sparse, &truth);
            let count = stayed.iter().filter(|&&stayed| stayed).count();
            assert_eq!(count + sparse.hidden, inside.len(), "{name}, {form}");
            assert_eq!(
                (sparse.outside, sparse.ignored),
                (beside.len(), 1),
                "{name}, {form}"
            );
            // All points are visible; at inner edges some are misjudged as hidden.
            assert!(
                sparse.hidden * 50 < inside.len(),
                "{name}, {form}: {}",
                sparse.hidden
            );
        }
    }
}

#[test]
fn pixels_and_points_are_each_others() {
    let folder = tempfile::tempdir().unwrap();
    let scene = Scene::room();
    for (name, camera) in Camera::each() {
        let read = data::Camera::read(&write_camera(folder.path(), &camera)).unwrap();
        for point in visible(&scene, &camera, 500) {
            let truth = camera.see_inside(point).unwrap();
            let ([u, v], depth) = read.project(point).unwrap();
            let off = (u - truth.place[0]).hypot(v - truth.place[1]);
            assert!(off < 1e-9, "{name}: {off} px");
            assert!((depth / truth.depth - 1.0).abs() < 1e-12, "{name}");
            let back = read.unproject(truth.place, truth.depth).unwrap();
            let off = along(back, -1.0, point);
            assert!(off.iter().all(|v| v.abs() < 1e-6), "{name}: {off:?} m");
        }
        // Folded back, some of these would be inside the image.
        for point in around(&scene, &camera, 500) {
            let seen = read.project(point).map(|(place, _)| place);
            let inside = |length: usize, v: f64| (-0.5..length as f64 - 0.5).contains(&v);
            let inside =
                seen.is_some_and(|[u, v]| inside(camera.size.0, u) && inside(camera.size.1, v));
            assert!(!inside, "{name}: {point:?} at {seen:?}");
        }
    }
}
