//! Depth maps with fewer pixels than the image.

use crate::camera::{Camera, Sight};
use crate::completion::{BIAS, bias, smooth};
use crate::files::write_npy;
use crate::observed::assert_all;
use crate::scene::Scene;
use lsdc_eval::data::Sparse;
use std::path::Path;

/// Divisible by all factors.
const SIZE: (usize, usize) = (240, 120);

/// Writes a map of the depths at its pixel centres, and returns the observations read back and the true ones.
fn read(folder: &Path, scene: &Scene, camera: &Camera, factor: usize) -> (Sparse, Vec<Sight>) {
    let (width, height) = (camera.size.0 / factor, camera.size.1 / factor);
    let centre = |i: usize| (i as f64 + 0.5) * factor as f64 - 0.5;
    let sight = |i: usize| {
        let place = [centre(i % width), centre(i / width)];
        let depth = scene.depth(camera, place);
        Sight { place, depth }
    };
    let truth: Vec<Sight> = (0..width * height).map(sight).collect();
    let path = folder.join("map.npy");
    let values = truth.iter().map(|sight| sight.depth as f32).collect();
    write_npy(&path, [height, width], values);
    let sparse = Sparse::read(&path, None, None, camera.size).unwrap();
    (sparse, truth)
}

#[test]
fn pixels_of_smaller_maps_are_at_their_centres() {
    let folder = tempfile::tempdir().unwrap();
    let camera = Camera::level(SIZE, 200.0, [-0.4, -7.6, 1.5]);
    for factor in [1, 2, 3, 4, 5, 8] {
        let (sparse, truth) = read(folder.path(), &Scene::room(), &camera, factor);
        assert_all(&sparse, &truth, &format!("/{factor}"));
    }
}

/// With positions off by half a pixel, a former bug of maps at even factors, depths would be off by millimetres.
#[test]
fn smaller_maps_do_not_shift_a_slanted_plane() {
    const SIZE: (usize, usize) = (480, 240);
    let folder = tempfile::tempdir().unwrap();
    let (scene, camera) = (Scene::slanted(), Camera::level(SIZE, 400.0, [0.0; 3]));
    let middle = camera.center.map(|v| v + 0.5);
    let shift = scene.depth(&camera, middle) - scene.depth(&camera, camera.center);
    assert!(shift > 9.0 * BIAS, "{shift} m");
    for factor in [2, 3, 4] {
        let (sparse, _) = read(folder.path(), &scene, &camera, factor);
        let bias = bias(&smooth(&sparse), &scene, &camera);
        assert!(bias.abs() < BIAS, "/{factor}: {bias} m");
    }
}
