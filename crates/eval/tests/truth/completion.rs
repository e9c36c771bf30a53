//! Completed depths with exactly known errors.

use crate::camera::Camera;
use crate::files::{write_camera, write_cloud};
use crate::scene::Scene;
use crate::spread;
use image::{Rgb, RgbImage};
use lsdc_core::settings::{FitConfig, FitMethod};
use lsdc_core::{Completer, Weights};
use lsdc_eval::data::{self, DepthMap, Sparse};
use lsdc_eval::predict::{Classic, complete_classic};

/// Largest mean error of a plane, in metres.
pub(crate) const BIAS: f64 = 2e-4;

/// Completes depths with the smooth field alone, under an image of one colour.
pub(crate) fn smooth(sparse: &Sparse) -> DepthMap {
    let weights = Weights::builtin();
    let fit = FitConfig {
        method: FitMethod::Field,
        ..weights.fit().unwrap().unwrap_or_default()
    };
    let completer = Completer::builder(&weights).fit(fit).build().unwrap();
    let (width, height) = sparse.size;
    let image = RgbImage::from_pixel(width as u32, height as u32, Rgb([128; 3]));
    let scene = lsdc_eval::predict::scene(&completer, &image).unwrap();
    scene.complete(&sparse.points).unwrap().depth().unwrap()
}

/// Returns the mean error of a map in metres.
pub(crate) fn bias(depth: &DepthMap, scene: &Scene, camera: &Camera) -> f64 {
    mean(errors(depth, scene, camera))
}

/// Returns the root of the mean squared error of a map in metres.
fn rmse(depth: &DepthMap, scene: &Scene, camera: &Camera) -> f64 {
    mean(errors(depth, scene, camera).map(|error| error * error)).sqrt()
}

/// Returns the errors of all pixels, which must all have a depth.
fn errors(depth: &DepthMap, scene: &Scene, camera: &Camera) -> impl ExactSizeIterator<Item = f64> {
    assert_eq!((depth.width(), depth.height()), camera.size);
    let width = depth.width();
    (0..depth.values().len()).map(move |i| {
        let (x, y) = (i % width, i / width);
        let found = depth.at(x, y);
        assert!(found > 0.0, "no depth at {x}, {y}");
        f64::from(found) - scene.depth(camera, [x as f64, y as f64])
    })
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    values.sum::<f64>() / count
}

#[test]
fn a_room_is_completed_through_each_lens() {
    let folder = tempfile::tempdir().unwrap();
    let completer = Completer::new(&Weights::builtin()).unwrap();
    let scene = Scene::room();
    for (name, camera) in Camera::each() {
        let (width, height) = camera.size;
        let points: Vec<_> = (0..500)
            .map(|i| {
                let [a, b] = spread(i);
                let place = [a * width as f64 - 0.5, b * height as f64 - 0.5];
                scene.point(&camera, place)
            })
            .collect();
        let cloud = write_cloud(folder.path(), "ply", &points);
        let read = data::Camera::read(&write_camera(folder.path(), &camera)).unwrap();
        let sparse = Sparse::read(&cloud, None, Some(&read), camera.size).unwrap();
        let image = scene.render(&camera);
        let seen = lsdc_eval::predict::scene(&completer, &image).unwrap();
        let depth = seen.complete(&sparse.points).unwrap().depth().unwrap();
        let nearest = complete_classic(Classic::Nearest, &image, &sparse.map().unwrap()).unwrap();
        let error = rmse(&depth, &scene, &camera);
        let plain = rmse(&nearest, &scene, &camera);
        assert!(error < 0.8 * plain, "{name}: {error} m, nearest {plain} m");
    }
}
