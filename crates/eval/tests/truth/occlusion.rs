//! Points behind objects, seen by a scanner beside the camera but hidden from the camera.

use crate::camera::{Camera, Lens, Sight};
use crate::files::{write_camera, write_cloud};
use crate::observed::observed;
use crate::scene::{Scene, Surface};
use crate::vector::Vector;
use lsdc_eval::data::{self, Sparse};

/// A box at 2.5 m in front of a wall at 5 m.
fn scene() -> Scene {
    Scene(vec![
        Surface::Plane {
            point: [0.0, 5.0, 0.0],
            normal: [0.0, 1.0, 0.0],
        },
        Surface::Block {
            low: [-0.6, 2.5, -0.8],
            high: [0.7, 3.2, 0.5],
        },
    ])
}

/// Returns the points of a rotating scanner with rings over 51 degrees; points are four times as dense along a ring.
fn scanned(scene: &Scene, scanner: Vector, rings: usize) -> Vec<Vector> {
    let step = 51.2 / rings as f64;
    let direction = |ring: usize, column: usize| {
        let up = (ring as f64 - (rings as f64 - 1.0) / 2.0) * step;
        let right = (column as f64 * step / 4.0) - 45.0;
        let (up, level) = up.to_radians().sin_cos();
        let (right, ahead) = right.to_radians().sin_cos();
        [level * right, level * ahead, up]
    };
    let columns = (360.0 / step) as usize;
    (0..rings)
        .flat_map(|ring| (0..=columns).map(move |column| direction(ring, column)))
        .filter_map(|ray| scene.meets(scanner, ray))
        .collect()
}

#[test]
fn a_wall_behind_a_box_is_hidden_from_a_camera_beside_the_scanner() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene();
    let level = |focal| Camera::level((640, 480), focal, [0.35, 0.1, -0.1]);
    let fisheye = Camera {
        lens: Lens::Fisheye([0.02, -0.004, 0.001, -0.0002]),
        ..level(280.0)
    };
    // Largest share of occluded points kept: the fewer rings, the more.
    for (name, camera, rings, most) in [
        ("pinhole", level(520.0), 64, 0.08),
        ("pinhole", level(520.0), 48, 0.16),
        ("fisheye", fisheye, 64, 0.08),
        ("fisheye", fisheye, 48, 0.16),
    ] {
        let mut points = scanned(&scene, [-0.2, 0.0, 0.2], rings);
        points.retain(|&point| camera.see_inside(point).is_some());
        let shown: Vec<bool> = points.iter().map(|&p| scene.shows(&camera, p)).collect();
        let truth: Vec<Sight> = points
            .iter()
            .map(|&p| camera.see_inside(p).unwrap())
            .collect();
        let read = data::Camera::read(&write_camera(folder.path(), &camera)).unwrap();
        let path = write_cloud(folder.path(), "ply", &points);
        let sparse = Sparse::read(&path, None, Some(&read), camera.size).unwrap();
        let stayed = observed(&sparse, &truth);
        let count = |shows: bool, stays: bool| {
            let pairs = shown.iter().zip(&stayed);
            pairs.filter(|&(&a, &b)| a == shows && b == stays).count()
        };
        let (hidden, leaking) = (count(false, false), count(false, true));
        let (kept, lost) = (count(true, true), count(true, false));
        let what = format!("{name}, {rings} rings");
        assert_eq!(hidden + lost, sparse.hidden, "{what}");
        assert!(hidden + leaking > 500, "{what}: {hidden} + {leaking}");
        let share = leaking as f64 / (hidden + leaking) as f64;
        assert!(share < most, "{what}: {share}");
        assert!(lost * 50 < kept + lost, "{what}: {lost} of {}", kept + lost);
    }
}
