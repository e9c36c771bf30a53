use super::*;
use crate::ColoredPoint;
use crate::{Colmap, DepthMap, write_exr, write_npy, write_npz, write_pfm, write_ply, write_tiff};

const SIZE: (usize, usize) = (4, 3);

/// Reads a text as the points of an image of [`SIZE`].
fn read_as(name: &str, text: &str, unit: Option<Unit>) -> Result<Sparse> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, text).unwrap();
    Sparse::read(&path, unit, None, SIZE)
}

fn read(text: &str) -> Result<Sparse> {
    read_as("points.csv", text, None)
}

/// u, v and depth of every point.
fn points(sparse: &Sparse) -> Vec<(f64, f64, f32)> {
    let points = sparse.points.iter();
    points
        .map(|point| (point.u, point.v, point.depth))
        .collect()
}

#[test]
fn points_keep_their_places_between_pixels() {
    let text = "u,v,depth\n0.25,0,2000\n3.4,2.49,1500\n-0.6,0,1\n0,2.5,1\n1,1,nan\n";
    let found = read_as("points.csv", text, Some(Unit::MILLIMETRE)).unwrap();
    assert_eq!((found.outside, found.ignored, found.hidden), (2, 1, 0));
    assert_eq!(points(&found), [(0.25, 0.0, 2.0), (3.4, 2.49, 1.5)]);
    assert!(!found.guessed);
    let [remark] = &found.remarks[..] else {
        panic!("{:?}", found.remarks);
    };
    assert!(
        remark.starts_with("2 of 4 points are outside the image"),
        "{remark}"
    );
}

#[test]
fn all_points_of_a_surface_stay_in_a_pixel_and_those_behind_a_gap_are_hidden() {
    let lines = ["1,1,2.0", "1.2,1,2.04", "0.8,1.1,1.98", "1.1,1,4.0"];
    let mut orders = vec![lines.to_vec()];
    orders.push(lines.iter().rev().copied().collect());
    for lines in orders {
        let found = read(&lines.join("\n")).unwrap();
        assert_eq!((found.points.len(), found.hidden), (3, 1));
        // The mean depth of the surface.
        let depth = found.map().unwrap().at(1, 1);
        assert!((depth - (2.0 + 2.04 + 1.98) / 3.0).abs() < 1e-6, "{depth}");
    }
}

#[test]
fn points_of_one_pixel_are_weighted_by_their_precision() {
    let found = read("1,1,2.0,0.1\n1,1,2.06,0.2\n").unwrap();
    let (depth, sigma) = found.maps().unwrap();
    // The weights are 100 and 25.
    assert!((depth.at(1, 1) - (200.0 + 51.5) / 125.0).abs() < 1e-6);
    assert!((sigma.unwrap().at(1, 1) - (1.0_f32 / 125.0).sqrt()).abs() < 1e-7);
    // The nearer point has no weight, so that the other one is kept.
    let found = read("1,1,1,5\n1,1,3,0.01\n").unwrap();
    assert_eq!((found.points.len(), found.hidden), (2, 0));
    assert!((found.map().unwrap().at(1, 1) - 3.0).abs() < 1e-4);
}

#[test]
fn unusable_deviations_are_unknown_and_counted() {
    for bad in ["0", "-1", "nan", "inf"] {
        let text = format!("u,v,depth,sigma\n0,0,1,0.1\n1,0,1,{bad}\n2,0,1,0.1\n3,0,1,{bad}\n");
        let found = read(&text).unwrap();
        assert_eq!((found.points.len(), found.ignored), (4, 0), "{bad}");
        let sigmas: Vec<_> = found.points.iter().map(|point| point.sigma).collect();
        assert_eq!(sigmas, [Some(0.1), None, Some(0.1), None], "{bad}");
        let remark = &found.remarks[0];
        assert!(remark.starts_with("2 points have no usable"), "{remark}");
        assert!(remark.ends_with("the first is line 3"), "{remark}");
    }
}

#[test]
fn marks_in_tables_are_left_out_and_counted() {
    let line = |i: usize| {
        let depth = if i < 3 {
            "65535".to_owned()
        } else {
            format!("{}", 1000 + 70 * i)
        };
        format!("{},{},{depth}\n", i % 4, i / 4)
    };
    let lines: String = (0..12).map(line).collect();
    let text = format!("u,v,depth\n{lines}");
    let found = read_as("points.csv", &text, Some(Unit::MILLIMETRE)).unwrap();
    assert_eq!((found.points.len(), found.ignored), (9, 3));
    assert!(
        found.remarks[0].starts_with("3 depths (25 %) are 65535"),
        "{:?}",
        found.remarks
    );
}

/// A plane at z = 2, stored as distances from the optical centre.
#[test]
fn distances_along_the_ray_become_depths_with_a_camera() {
    let folder = tempfile::tempdir().unwrap();
    let camera = Camera::pinhole([3.0, 4.0], [1.5, 1.0]);
    let length =
        |u: f64, v: f64| (1.0 + ((u - 1.5) / 3.0).powi(2) + ((v - 1.0) / 4.0).powi(2)).sqrt();
    let position = |i: usize| ((i % 4) as f64, (i / 4) as f64);
    let values = (0..12).map(|i| (2.0 * length(position(i).0, position(i).1)) as f32);
    let path = folder.path().join("frame.0000.depth_meters.npy");
    write_npy(&path, &DepthMap::new(4, 3, values.collect()).unwrap()).unwrap();
    let how = |kind| DepthReadOptions { unit: None, kind };
    let found = Sparse::read_as(&path, how(Some(DepthKind::Ray)), Some(&camera), SIZE).unwrap();
    assert!(
        found
            .points
            .iter()
            .all(|point| (point.depth - 2.0).abs() < 1e-6)
    );
    let error = Sparse::read_as(&path, how(Some(DepthKind::Ray)), None, SIZE).unwrap_err();
    assert!(error.advice().unwrap().contains("--camera"));
    // A name that denotes distances gives a warning, unless the kind is given.
    let named = folder.path().join("distance.npy");
    std::fs::rename(&path, &named).unwrap();
    let remarks = |kind| {
        Sparse::read_as(&named, how(kind), Some(&camera), SIZE)
            .unwrap()
            .remarks
    };
    assert!(
        remarks(None)[0].contains("--depth-kind ray"),
        "{:?}",
        remarks(None)
    );
    assert!(remarks(Some(DepthKind::Z)).is_empty());
}

/// A map of 4x3 distinct values.
fn map(first: f32) -> DepthMap {
    let values = (0..12).map(|i| first + i as f32 * 0.123).collect();
    DepthMap::new(4, 3, values).unwrap()
}

#[test]
fn what_is_written_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let (depth, sigma) = (map(1.0), map(0.01));
    let at = |name: &str| folder.path().join(name);
    write_pfm(&at("a.pfm"), &depth).unwrap();
    write_tiff(&at("a.tiff"), &depth).unwrap();
    write_exr(&at("a.exr"), &depth, None).unwrap();
    write_exr(&at("b.EXR"), &depth, Some(&sigma)).unwrap();
    write_npz(&at("a.npz"), &[("anything", &depth)]).unwrap();
    write_npz(&at("b.npz"), &[("depth", &depth), ("sigma", &sigma)]).unwrap();
    for (name, with) in [
        ("a.pfm", None),
        ("a.tiff", None),
        ("a.exr", None),
        ("b.EXR", Some(&sigma)),
        ("a.npz", None),
        ("b.npz", Some(&sigma)),
    ] {
        let found = Sparse::read(&at(name), None, None, SIZE).unwrap();
        let (again, sigmas) = found.maps().unwrap();
        assert_eq!(again, depth, "{name}");
        let pairs = sigmas.iter().flat_map(DepthMap::values).zip(sigma.values());
        pairs.for_each(|(a, b)| assert!((a - b).abs() < 1e-7 * b, "{name}"));
        assert_eq!(sigmas.is_some(), with.is_some(), "{name}");
        assert_eq!((found.unit, found.guessed), (Unit::METRE, false));
        let found = Sparse::read(&at(name), Some(Unit::MILLIMETRE), None, SIZE).unwrap();
        assert!(
            (found.map().unwrap().at(0, 0) - 0.001).abs() < 1e-9,
            "{name}"
        );
        assert!(!found.guessed);
    }
}

/// On a slanted plane, depth 1 + 0.01 u + 0.02 v, the depth of each pixel of a smaller map is that at its centre.
#[test]
fn a_smaller_map_lies_where_the_centres_of_its_pixels_are() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("small.npy");
    let (width, height) = (80_usize, 40_usize);
    let plane = |u: f64, v: f64| 1.0 + 0.01 * u + 0.02 * v;
    for factor in [1, 2, 4, 5, 8] {
        let centre = |i: usize| (i as f64 + 0.5) * factor as f64 - 0.5;
        let (across, down) = (width / factor, height / factor);
        let values = (0..across * down)
            .map(|i| plane(centre(i % across), centre(i / across)) as f32)
            .collect();
        write_npy(&path, &DepthMap::new(across, down, values).unwrap()).unwrap();
        let found = Sparse::read(&path, None, None, (width, height)).unwrap();
        assert_eq!(found.points.len(), across * down);
        for point in &found.points {
            assert!((f64::from(point.depth) - plane(point.u, point.v)).abs() < 1e-6);
        }
        // The map has no bias to any side either.
        let map = found.map().unwrap();
        let deviation = map
            .points()
            .map(|p| f64::from(p.depth) - plane(p.x as f64, p.y as f64));
        let bias = deviation.sum::<f64>() / map.count() as f64;
        assert!(bias.abs() < 1e-6, "{factor}: {bias}");
    }
}

/// A map of twice the resolution of the image, on the plane of the test above.
#[test]
fn a_larger_map_is_averaged_without_bias() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("large.npy");
    let plane = |u: f64, v: f64| 1.0 + 0.01 * u + 0.02 * v;
    let centre = |i: usize| (i as f64 + 0.5) * 0.5 - 0.5;
    let values = (0..80 * 40).map(|i| plane(centre(i % 80), centre(i / 80)) as f32);
    write_npy(&path, &DepthMap::new(80, 40, values.collect()).unwrap()).unwrap();
    let found = Sparse::read(&path, None, None, (40, 20)).unwrap();
    assert_eq!((found.points.len(), found.hidden), (3200, 0));
    for p in found.map().unwrap().points() {
        assert!((f64::from(p.depth) - plane(p.x as f64, p.y as f64)).abs() < 1e-6);
    }
}

#[test]
fn a_map_of_another_shape_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.npy");
    write_npy(&path, &DepthMap::new(30, 10, vec![1.0; 300]).unwrap()).unwrap();
    let error = Sparse::read(&path, None, None, (40, 30)).unwrap_err();
    assert!(
        error.to_string().contains("30x10 but the image is 40x30"),
        "{error}"
    );
    assert!(error.advice().is_some());
}

#[test]
fn images_that_fit_into_no_memory_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("points.csv");
    std::fs::write(&path, "u,v,depth\n1,1,2\n").unwrap();
    for size in [(65536, 65536), (usize::MAX, 2)] {
        let error = Sparse::read(&path, None, None, size).unwrap_err();
        assert!(error.to_string().contains("is too large"), "{error}");
    }
}

#[test]
fn a_table_beside_the_image_is_refused() {
    let error = read("u,v,depth\n100,100,1\n0,0,-1\n").unwrap_err();
    assert!(
        error.to_string().contains("none of its 2 points"),
        "{error}"
    );
}

/// The projection of x, y, z by a pinhole camera: f x / z + c.
#[test]
fn tables_of_x_y_z_are_clouds() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let camera = Camera::pinhole([100.0; 2], [99.5, 79.5]);
    let cloud: Vec<[f64; 3]> = (0..200)
        .map(|i| {
            let step = |k: usize| (i * k % 200) as f64 / 199.0 - 0.5;
            [4.0 * step(7), 3.0 * step(13), 5.0 + 0.2 * step(3)]
        })
        .collect();
    let lines = |separator: &str| -> String {
        let line = |[x, y, z]: &[f64; 3]| format!("{x}{separator}{y}{separator}{z}\n");
        cloud.iter().map(line).collect()
    };
    std::fs::write(at("named.csv"), format!("x,y,z\n{}", lines(","))).unwrap();
    std::fs::write(at("bare.txt"), lines(" ")).unwrap();
    std::fs::write(at("scan.xyz"), lines(" ")).unwrap();
    let records = cloud.iter().flat_map(|[x, y, z]| [*x, *y, *z, 0.5]);
    let floats: Vec<f32> = records.map(|v| v as f32).collect();
    let bytes: Vec<u8> = floats.iter().flat_map(|v| v.to_le_bytes()).collect();
    std::fs::write(at("scan.bin"), bytes).unwrap();
    let array = DepthMap::new(4, 200, floats.iter().map(|v| v + 10.0).collect()).unwrap();
    write_npy(&at("four.npy"), &array).unwrap();
    let colored = cloud.iter().map(|&position| ColoredPoint {
        position,
        color: [0; 3],
        sigma: None,
    });
    write_ply(&at("scan.ply"), &colored.collect::<Vec<_>>()).unwrap();
    let size = (200, 160);
    let expected = Sparse::read(&at("scan.ply"), None, Some(&camera), size).unwrap();
    assert!(expected.points.len() > 150);
    for point in &expected.points {
        let seen = |[x, y, z]: &[f64; 3]| {
            let position = [100.0 * x / z + 99.5, 100.0 * y / z + 79.5];
            let deviation = (position[0] - point.u).hypot(position[1] - point.v);
            // 32-bit coordinates.
            deviation < 1e-4 && (*z as f32) == point.depth
        };
        assert!(cloud.iter().any(seen), "{point:?}");
    }
    for name in ["named.csv", "bare.txt", "scan.xyz", "scan.bin"] {
        let found = Sparse::read(&at(name), None, Some(&camera), size).unwrap();
        assert_eq!(found.points.len(), expected.points.len(), "{name}");
        for (a, b) in found.points.iter().zip(&expected.points) {
            assert!((a.u - b.u).abs() + (a.v - b.v).abs() < 1e-3, "{name}");
            assert!(
                (a.depth - b.depth).abs() < 1e-5 && a.sigma.is_none(),
                "{name}"
            );
        }
        let error = Sparse::read(&at(name), None, None, size).unwrap_err();
        let hint = error.advice().unwrap_or_default();
        assert!(hint.contains("--camera"), "{name}: {error}");
    }
    // All points are to the right and below: they may be pixels as well as a cloud.
    let error = Sparse::read(&at("four.npy"), None, Some(&camera), size).unwrap_err();
    assert!(error.to_string().contains("may be u, v, depth"), "{error}");
}

/// One point at (3, 1) of 8x6 stored pixels, which EXIF 6 rotates to (6 - 1 - 1, 3).
#[test]
fn keypoints_of_colmap_are_turned_with_the_image() {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in [
        ("cameras.txt", "1 PINHOLE 8 6 10 10 4 3\n"),
        ("images.txt", "1 1 0 0 0 0 0 0 1 a.jpg\n3.5 1.5 1\n"),
        ("points3D.txt", "1 0 0 5 0 0 0 0.5 1 0 2 0\n"),
    ] {
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    let view = &Colmap::read(folder.path()).unwrap().views[0];
    let expected = [
        [3.0, 1.0],
        [4.0, 1.0],
        [4.0, 4.0],
        [3.0, 4.0],
        [1.0, 3.0],
        [4.0, 3.0],
        [4.0, 4.0],
        [1.0, 4.0],
    ];
    for (exif, [u, v]) in (1..=8).zip(expected) {
        let image = Orientation::new((8, 6), exif);
        let found = Sparse::of_view(view, image, None).unwrap();
        assert_eq!(points(&found), [(u, v, 5.0)], "{exif}");
        assert_eq!((found.size, found.unit), (image.upright(), Unit::MODEL));
        // The camera of the view agrees: it sees x = (3 - 3.5) / 10 z there.
        let camera = view.camera_of(&image, None).unwrap().unwrap();
        let (position, depth) = camera.project([-0.25, -0.75, 5.0]).unwrap();
        assert!(
            (position[0] - u).abs() + (position[1] - v).abs() < 1e-9,
            "{exif} {position:?}"
        );
        assert_eq!(depth, 5.0);
        let [x, y, z] = camera.unproject(position, 5.0).unwrap();
        assert!((x + 0.25).abs() + (y + 0.75).abs() + (z - 5.0).abs() < 1e-9);
    }
    // Half the size, and in millimetres.
    let half = Sparse::of_view(view, Orientation::new((4, 3), 6), Some(Unit::MILLIMETRE)).unwrap();
    assert_eq!(points(&half), [(1.75, 1.25, 0.005)]);
    for size in [(8, 8), (100, 50)] {
        let error = Sparse::of_view(view, size, None).unwrap_err();
        assert!(error.to_string().contains("is 8x6 in the model"), "{error}");
    }
}

#[test]
fn maps_and_deviations_are_turned_with_the_image() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_npy(&at("depth.npy"), &map(1.0)).unwrap();
    write_npy(&at("sigma.npy"), &map(0.01)).unwrap();
    let image = Orientation::new((4, 3), 6);
    let found = Sparse::read(&at("depth.npy"), None, None, image).unwrap();
    assert_eq!(found.size, (3, 4));
    let remark = &found.remarks[0];
    assert!(remark.contains("turned upright with the image"), "{remark}");
    let (depth, sigma) = {
        let found = found.with_sigma(&at("sigma.npy"), image).unwrap();
        found.maps().unwrap()
    };
    let sigma = sigma.unwrap();
    for y in 0..3 {
        for x in 0..4 {
            assert_eq!(depth.at(2 - y, x), map(1.0).at(x, y));
            assert!((sigma.at(2 - y, x) - map(0.01).at(x, y)).abs() < 1e-8);
        }
    }
}

#[test]
fn background_between_the_returns_of_an_object_is_hidden() {
    const SCAN: (usize, usize) = (600, 200);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scan.npy");
    let mut depths = vec![0.0; SCAN.0 * SCAN.1];
    let mut between = Vec::new();
    for v in (0..SCAN.1).step_by(5) {
        for u in (0..SCAN.0).step_by(4) {
            let is_object = (200..300).contains(&u) && (50..150).contains(&v);
            depths[v * SCAN.0 + u] = if is_object { 8.0 } else { 30.0 };
            if is_object && u < 213 {
                between.push((u + 1, v + 2));
            }
        }
    }
    let read = |depths: &[f32]| {
        write_npy(
            &path,
            &DepthMap::new(SCAN.0, SCAN.1, depths.to_vec()).unwrap(),
        )
        .unwrap();
        Sparse::read(&path, None, None, SCAN).unwrap()
    };
    assert_eq!(read(&depths).hidden, 0);
    for &(u, v) in &between {
        depths[v * SCAN.0 + u] = 30.0;
    }
    let found = read(&depths);
    let map = found.map().unwrap();
    assert!(between.iter().all(|&(u, v)| map.at(u, v) == 0.0));
    assert!((between.len()..2 * between.len() + 200).contains(&found.hidden));
    let objects = |values: &[f32]| values.iter().filter(|depth| **depth == 8.0).count();
    assert_eq!(objects(map.values()), objects(&depths));
}
