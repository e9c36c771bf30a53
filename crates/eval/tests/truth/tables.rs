//! Tables with positions between pixels, and with more points than pixels.

use crate::camera::{Camera, Sight};
use crate::completion::{BIAS, bias, smooth};
use crate::files::{write_camera, write_cloud, write_table};
use crate::observed::assert_all;
use crate::scene::Scene;
use crate::spread;
use lsdc_eval::data::{self, Sparse};

#[test]
fn tables_say_exactly_where_points_are() {
    let folder = tempfile::tempdir().unwrap();
    let scene = Scene::room();
    for (name, camera) in Camera::each() {
        let (width, height) = camera.size;
        let sight = |i| {
            let [a, b] = spread(i);
            let place = [a * width as f64 - 0.5, b * height as f64 - 0.5];
            let depth = scene.depth(&camera, place);
            Sight { place, depth }
        };
        let truth: Vec<Sight> = (0..1000).map(sight).collect();
        let path = write_table(folder.path(), &truth);
        let sparse = Sparse::read(&path, None, None, camera.size).unwrap();
        assert_all(&sparse, &truth, name);
        for (found, truth) in sparse.points.iter().zip(&truth) {
            assert_eq!([found.u, found.v], truth.place, "{name}");
            assert_eq!(found.depth, truth.depth as f32, "{name}");
        }
    }
}

/// If the nearest point of each pixel represented the pixel, a former bug, the plane would be millimetres too near.
#[test]
fn eight_points_a_pixel_do_not_pull_a_plane() {
    const SIZE: (usize, usize) = (160, 120);
    let folder = tempfile::tempdir().unwrap();
    let (scene, camera) = (Scene::slanted(), Camera::level(SIZE, 150.0, [0.0; 3]));
    let place = |i: usize| {
        let [a, b] = spread(i);
        let pixel = i / 8;
        [
            (pixel % SIZE.0) as f64 + a - 0.5,
            (pixel / SIZE.0) as f64 + b - 0.5,
        ]
    };
    let points: Vec<_> = (0..8 * SIZE.0 * SIZE.1)
        .map(|i| scene.point(&camera, place(i)))
        .collect();
    let truth: Vec<Sight> = points
        .iter()
        .map(|&p| camera.see_inside(p).unwrap())
        .collect();
    let nearest = |sights: &[Sight]| sights.iter().map(|s| s.depth).fold(f64::INFINITY, f64::min);
    let pull = |(i, sights): (usize, &[Sight])| {
        let middle = [i % SIZE.0, i / SIZE.0].map(|v| v as f64);
        nearest(sights) - scene.depth(&camera, middle)
    };
    let pull = truth.chunks(8).enumerate().map(pull).sum::<f64>() / (SIZE.0 * SIZE.1) as f64;
    assert!(pull < -10.0 * BIAS, "{pull} m");
    let read = data::Camera::read(&write_camera(folder.path(), &camera)).unwrap();
    let table = write_table(folder.path(), &truth);
    let cloud = write_cloud(folder.path(), "ply", &points);
    for (name, path, camera_of) in [("table", table, None), ("cloud", cloud, Some(&read))] {
        let sparse = Sparse::read(&path, None, camera_of, SIZE).unwrap();
        assert_all(&sparse, &truth, name);
        let completed = bias(&smooth(&sparse), &scene, &camera);
        let averaged = bias(&sparse.map().unwrap(), &scene, &camera);
        assert!(completed.abs() < BIAS, "{name}: {completed} m");
        assert!(averaged.abs() < BIAS, "{name}: {averaged} m");
    }
}
