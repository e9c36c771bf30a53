//! Photos stored with a rotation.

use crate::camera::{Camera, Lens, Sight};
use crate::files::{CLOUDS, write_camera, write_cloud, write_model, write_photo};
use crate::observed::{assert_all, observed};
use crate::scene::Scene;
use crate::vector::{Vector, along};
use lsdc_eval::data::{self, Colmap, Sparse, read_upright};

const SIZE: (usize, usize) = (96, 64);

/// Returns the position in the upright image of a stored position, by the wording of EXIF 2.32: "the 0th row is at the visual
/// top, the 0th column at the visual left" and so on.
fn upright(orientation: u8, [u, v]: [f64; 2]) -> [f64; 2] {
    let (right, bottom) = (SIZE.0 as f64 - 1.0 - u, SIZE.1 as f64 - 1.0 - v);
    match orientation {
        1 => [u, v],
        2 => [right, v],
        3 => [right, bottom],
        4 => [u, bottom],
        5 => [v, u],
        6 => [bottom, u],
        7 => [bottom, right],
        8 => [v, right],
        _ => unreachable!(),
    }
}

/// A phone's camera: a principal point off the centre, and pixels that are not square.
fn phone() -> Camera {
    Camera {
        focal: [88.0, 91.0],
        center: [49.3, 29.2],
        lens: Lens::Radtan([-0.12, 0.03, 0.0011, -0.0007]),
        ..Camera::level(SIZE, 90.0, [-0.3, -7.5, 1.4]).turned(3.0, 8.0, 5.0)
    }
}

#[test]
fn points_of_turned_photos_are_where_the_upright_image_shows_them() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, camera) = (Scene::room(), phone());
    let image = scene.render(&camera);
    let pixels: Vec<[u32; 2]> = (0..SIZE.1 as u32)
        .step_by(5)
        .flat_map(|y| (0..SIZE.0 as u32).step_by(7).map(move |x| [x, y]))
        .collect();
    let points: Vec<Vector> = pixels
        .iter()
        .map(|pixel| scene.point(&camera, pixel.map(f64::from)))
        .collect();
    let model = write_model(folder.path(), &camera, &points);
    let view = Colmap::read(&model).unwrap().views.remove(0);
    let read = data::Camera::read(&write_camera(folder.path(), &camera)).unwrap();
    for orientation in 1..=8 {
        let path = write_photo(folder.path(), &image, orientation);
        let read_back = read_upright(&path).unwrap();
        let (shown, turned) = (read_back.rgb, read_back.orientation);
        let truth: Vec<Sight> = points
            .iter()
            .map(|&point| {
                let sight = camera.see_inside(point).unwrap();
                let place = upright(orientation, sight.place);
                Sight { place, ..sight }
            })
            .collect();
        // The image itself: each point has the colour of its position.
        for (&[x, y], sight) in pixels.iter().zip(&truth) {
            let [u, v] = sight.place.map(|v| v.round() as u32);
            assert_eq!(
                shown.get_pixel(u, v),
                image.get_pixel(x, y),
                "{orientation}"
            );
        }
        let what = format!("orientation {orientation}");
        let sparse = Sparse::of_view(&view, turned, None).unwrap();
        assert_all(&sparse, &truth, &format!("{what}, model"));

        let (given, _) = read.for_image(&turned).unwrap();
        let of_model = view.camera_of(&turned, None).unwrap().unwrap();
        for form in CLOUDS {
            let cloud = write_cloud(folder.path(), form, &points);
            let sparse = Sparse::read(&cloud, None, Some(&given), turned).unwrap();
            let stayed = observed(&sparse, &truth);
            let count = stayed.iter().filter(|&&stayed| stayed).count();
            assert_eq!(count + sparse.hidden, points.len(), "{what}, {form}");
            // All points are visible, but there are so few that some at inner edges are misjudged as hidden.
            assert!(
                sparse.hidden * 10 < points.len(),
                "{what}, {form}: {}",
                sparse.hidden
            );
        }
        for camera in [given, of_model] {
            for (&point, truth) in points.iter().zip(&truth) {
                let ([u, v], depth) = camera.project(point).unwrap();
                let off = (u - truth.place[0]).hypot(v - truth.place[1]);
                assert!(
                    off < 1e-6 && (depth - truth.depth).abs() < 1e-9,
                    "{what}: {off} px"
                );
                let back = camera.unproject(truth.place, truth.depth).unwrap();
                let off = along(back, -1.0, point);
                assert!(off.iter().all(|v| v.abs() < 1e-6), "{what}: {off:?} m");
            }
        }
    }
}
