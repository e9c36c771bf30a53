//! Surfaces in closed form, rendered exactly.

#![allow(clippy::unwrap_used)]

use lsdc_core::{Camera, Channels, DepthMap, Image, Lens};
use lsdc_fusion::{Error, Frame, Fusion, LeftOut, Mesh, Settings};
use std::collections::HashMap;

type Vector = [f64; 3];

const WIDTH: usize = 160;
const HEIGHT: usize = 120;

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn normalised(v: Vector) -> Vector {
    v.map(|x| x / dot(v, v).sqrt())
}

fn cross(a: Vector, b: Vector) -> Vector {
    [0, 1, 2].map(|i| a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3])
}

/// Returns a camera at a position that looks at another position.
fn looking(from: Vector, at: Vector) -> Camera {
    let forwards = normalised([0, 1, 2].map(|i| at[i] - from[i]));
    let down = if forwards[1].abs() > 0.9 {
        [0.0, 0.0, 1.0]
    } else {
        [0.0, 1.0, 0.0]
    };
    let right = normalised(cross(down, forwards));
    let rows = [right, cross(forwards, right), forwards];
    Camera::pinhole([130.0, 130.0], [79.3, 59.8]).with_pose(rows, rows.map(|row| -dot(row, from)))
}

/// Returns the depths at which the rays of a camera intersect a surface; the arguments of `hit` are the camera's centre and the
/// direction of a ray to depth 1.
fn rendered(camera: &Camera, hit: impl Fn(Vector, Vector) -> Option<f64>) -> DepthMap {
    let (rotation, translation) = camera.pose();
    let center = [0, 1, 2].map(|i| {
        -(0..3)
            .map(|row| rotation[row][i] * translation[row])
            .sum::<f64>()
    });
    let values = (0..WIDTH * HEIGHT).map(|index| {
        let pixel = [(index % WIDTH) as f64, (index / WIDTH) as f64];
        let end = camera.unproject(pixel, 1.0)?;
        hit(center, [0, 1, 2].map(|i| end[i] - center[i]))
    });
    let values = values.map(|depth| depth.filter(|depth| *depth > 0.0).unwrap_or(0.0) as f32);
    DepthMap::new(WIDTH, HEIGHT, values.collect()).unwrap()
}

fn plane(normal: Vector, distance: f64) -> impl Fn(Vector, Vector) -> Option<f64> {
    move |from, along| Some((distance - dot(normal, from)) / dot(normal, along))
}

fn sphere(radius: f64) -> impl Fn(Vector, Vector) -> Option<f64> {
    move |from, along| {
        let (a, b, c) = (
            dot(along, along),
            dot(from, along),
            dot(from, from) - radius * radius,
        );
        let root = b * b - a * c;
        (root > 0.0).then(|| (-b - root.sqrt()) / a)
    }
}

fn settings(voxel: f64) -> Settings {
    Settings {
        voxel: Some(voxel),
        ..Settings::default()
    }
}

fn frame<'a>(depth: &'a DepthMap, camera: &'a Camera) -> Frame<'a> {
    Frame {
        depth,
        deviation: None,
        camera,
        image: None,
    }
}

fn fused(settings: Settings, frames: &[Frame<'_>]) -> Fusion {
    let mut fusion = Fusion::new(settings).unwrap();
    for frame in frames {
        fusion.integrate(frame).unwrap();
    }
    fusion
}

/// Counts the occurrences of each edge, in the order of its ends and in reverse.
fn edges(mesh: &Mesh) -> HashMap<(u32, u32), [usize; 2]> {
    let mut edges: HashMap<(u32, u32), [usize; 2]> = HashMap::new();
    for [a, b, c] in &mesh.triangles {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            let count = edges.entry((*from.min(to), *from.max(to))).or_default();
            count[usize::from(from > to)] += 1;
        }
    }
    edges
}

#[test]
fn a_tilted_plane_is_exact() {
    const EDGE: f64 = 0.03;
    let normal = normalised([0.3, -0.2, -1.0]);
    let cameras = [
        looking([0.1, -0.2, 0.0], [0.0, 0.0, 2.0]),
        looking([0.7, 0.3, 0.3], [0.1, 0.0, 2.0]),
        looking([0.1, -0.2, 0.0], [0.0, 0.0, 2.0]).with_lens(Lens::radial_tangential([
            -0.2, 0.05, 0.001, -0.002, 0.0, 0.0, 0.0, 0.0,
        ])),
    ];
    let maps = cameras
        .each_ref()
        .map(|camera| rendered(camera, plane(normal, -2.0)));
    let frames: Vec<Frame<'_>> = maps
        .iter()
        .zip(&cameras)
        .map(|(d, c)| frame(d, c))
        .collect();
    let mesh = fused(settings(EDGE), &frames).mesh().unwrap();
    assert!(mesh.triangles.len() > 5000, "{}", mesh.triangles.len());
    for (position, found) in mesh.positions.iter().zip(&mesh.normals) {
        assert!((dot(normal, *position) + 2.0).abs() < 1e-5, "{position:?}");
        assert!(dot(normal, found.map(f64::from)) > 1.0 - 1e-6, "{found:?}");
    }
    // Both triangles at an inner edge traverse it in opposite directions; a border edge has one triangle.
    let mut inner = 0;
    for [along, against] in edges(&mesh).into_values() {
        assert!(
            along <= 1 && against <= 1,
            "two triangles on one side of an edge"
        );
        inner += along * against;
    }
    assert!(inner > mesh.triangles.len(), "{inner}");
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|index| mesh.positions[index as usize]);
        let [u, v] = [b, c].map(|p| [0, 1, 2].map(|i| p[i] - a[i]));
        assert!(dot(cross(u, v), normal) >= -1e-9);
    }
}

/// Returns six distant views of a sphere. The space beyond its outline has no depths, so every part of the surface also needs a
/// view with the sphere behind the voxels in front of it.
fn views_of_a_sphere(radius: f64) -> (Vec<Camera>, Vec<DepthMap>) {
    let cameras: Vec<Camera> = (0..6)
        .map(|i| {
            let mut from = [0.0; 3];
            from[i / 2] = if i % 2 == 0 { 8.0 } else { -8.0 } * radius;
            let (rotation, translation) = looking(from, [0.0; 3]).pose();
            Camera::pinhole([400.0, 400.0], [79.3, 59.8]).with_pose(rotation, translation)
        })
        .collect();
    let maps = cameras
        .iter()
        .map(|camera| rendered(camera, sphere(radius)))
        .collect();
    (cameras, maps)
}

#[test]
fn a_sphere_is_closed() {
    const RADIUS: f64 = 0.5;
    const EDGE: f64 = 0.02;
    let (cameras, maps) = views_of_a_sphere(RADIUS);
    let frames: Vec<Frame<'_>> = maps
        .iter()
        .zip(&cameras)
        .map(|(d, c)| frame(d, c))
        .collect();
    let mesh = fused(settings(EDGE), &frames).mesh().unwrap();
    let (mut largest, mut sum, mut angles) = (0.0_f64, 0.0, Vec::new());
    for (position, normal) in mesh.positions.iter().zip(&mesh.normals) {
        let radius = dot(*position, *position).sqrt();
        largest = largest.max((radius - RADIUS).abs());
        sum += radius - RADIUS;
        let cosine = dot(normalised(*position), normal.map(f64::from));
        angles.push(cosine.min(1.0).acos().to_degrees());
    }
    assert!(largest < EDGE / 4.0, "{largest}");
    let mean_angle = angles.iter().sum::<f64>() / angles.len() as f64;
    let largest_angle = angles.iter().copied().fold(0.0, f64::max);
    // The field has a step at the end of a view.
    assert!(
        mean_angle < 2.0 && largest_angle < 15.0,
        "{mean_angle} {largest_angle}"
    );
    assert!(
        (sum / mesh.positions.len() as f64).abs() < EDGE / 20.0,
        "{sum}"
    );
    let edges = edges(&mesh);
    let open = edges.values().filter(|count| **count != [1, 1]).count();
    assert_eq!(open, 0, "of {} edges", edges.len());
    // Euler's formula for a sphere.
    let euler = mesh.positions.len() + mesh.triangles.len() - edges.len();
    assert_eq!(euler, 2);
    // The volume, by the divergence theorem.
    let volume: f64 = mesh
        .triangles
        .iter()
        .map(|triangle| {
            let [a, b, c] = triangle.map(|index| mesh.positions[index as usize]);
            dot(a, cross(b, c)) / 6.0
        })
        .sum();
    let exact = 4.0 / 3.0 * std::f64::consts::PI * RADIUS.powi(3);
    assert!((volume / exact - 1.0).abs() < 0.01, "{volume} {exact}");
}

#[test]
fn contradicting_depths_are_averaged_by_their_precision() {
    let camera = looking([0.0; 3], [0.0, 0.0, 1.0]);
    let depths = [2.0_f32, 2.03];
    let maps =
        depths.map(|depth| DepthMap::new(WIDTH, HEIGHT, vec![depth; WIDTH * HEIGHT]).unwrap());
    let deviations = [0.01_f32, 0.02].map(|deviation| vec![deviation; WIDTH * HEIGHT]);
    let mut fusion = Fusion::new(settings(0.03)).unwrap();
    for (depth, deviation) in maps.iter().zip(&deviations) {
        let frame = Frame {
            deviation: Some(deviation),
            ..frame(depth, &camera)
        };
        fusion.integrate(&frame).unwrap();
    }
    // 2 with weight 4 and 2.03 with weight 1.
    for position in fusion.mesh().unwrap().positions {
        assert!((position[2] - 2.006).abs() < 1e-5, "{position:?}");
    }
}

#[test]
fn pixels_that_are_left_out_are_counted() {
    let mut values = vec![2.0_f32; WIDTH * HEIGHT];
    let mut deviation = vec![0.01_f32; WIDTH * HEIGHT];
    // Apart from each other, so that all other pixels have neighbours.
    let at = |x: usize, y: usize| y * WIDTH + x;
    values[at(10, 10)] = 0.0;
    values[at(20, 10)] = f32::NAN;
    for x in [30, 40, 50] {
        deviation[at(x, 10)] = [0.3, 0.0, f32::NAN][(x - 30) / 10];
    }
    values[at(60, 10)] = 1000.0;
    // Surrounded by pixels without depth, in both directions.
    for (x, y) in [(79, 40), (81, 40), (80, 39), (80, 41)] {
        values[at(x, y)] = 0.0;
    }
    let depth = DepthMap::new(WIDTH, HEIGHT, values).unwrap();
    let camera = looking([0.0; 3], [0.0, 0.0, 1.0]);
    let frame = Frame {
        deviation: Some(&deviation),
        ..frame(&depth, &camera)
    };
    let limits = Settings {
        max_depth: 100.0,
        ..settings(0.05)
    };
    let fusion = fused(limits, &[frame]);
    let report = fusion.report();
    let LeftOut {
        unmeasured,
        far,
        uncertain,
        isolated,
        flying,
        grazing,
        outside_lens,
        ..
    } = report.left_out;
    assert_eq!((unmeasured, far, uncertain, isolated), (6, 1, 3, 1));
    assert_eq!((flying, grazing, outside_lens), (0, 0, 0));
    assert_eq!(report.pixels + report.left_out.total(), WIDTH * HEIGHT);
    assert_eq!(report.frames, 1);

    // A floor 0.1 below the camera: its angle exceeds 80 degrees beyond 0.1 tan 80 = 0.567 ahead.
    let floor = rendered(&camera, plane([0.0, 1.0, 0.0], 0.1));
    let steep = floor.points().filter(|point| {
        let [x, y, z] = camera
            .unproject([point.x as f64, point.y as f64], point.depth.into())
            .unwrap();
        x.hypot(z) > 0.1 * 80.0_f64.to_radians().tan() && y > 0.0
    });
    let steep = steep.count();
    let fusion = fused(
        settings(0.01),
        &[Frame {
            depth: &floor,
            camera: &camera,
            deviation: None,
            image: None,
        }],
    );
    let left_out = fusion.report().left_out;
    assert_eq!(left_out.grazing + left_out.flying, steep);
    assert!(left_out.grazing > 100, "{left_out:?}");
}

#[test]
fn colours_are_those_of_the_image() {
    let camera = looking([0.0; 3], [0.0, 0.0, 1.0]);
    let depth = DepthMap::new(WIDTH, HEIGHT, vec![2.0; WIDTH * HEIGHT]).unwrap();
    let halves: Vec<u8> = (0..WIDTH * HEIGHT)
        .flat_map(|index| {
            if index % WIDTH < WIDTH / 2 {
                [200, 10, 0]
            } else {
                [0, 10, 100]
            }
        })
        .collect();
    let image = Image::new(WIDTH, HEIGHT, Channels::Rgb, &halves).unwrap();
    let grey = vec![100_u8; WIDTH * HEIGHT];
    let grey = Image::new(WIDTH, HEIGHT, Channels::Gray, &grey).unwrap();
    let frames = [&image, &grey].map(|image| Frame {
        image: Some(image),
        ..frame(&depth, &camera)
    });
    let mesh = fused(settings(0.05), &frames).mesh().unwrap();
    assert_eq!(mesh.uncoloured, 0);
    let colours = mesh.colours.as_ref().unwrap();
    for (position, colour) in mesh.positions.iter().zip(colours) {
        // Column 79.5 is between both; a vertex between two voxels may have either value.
        let column = 130.0 * position[0] / 2.0 + 79.3;
        if column < 75.0 {
            assert_eq!(*colour, [150, 55, 50]);
        } else if column > 84.0 {
            assert_eq!(*colour, [50, 55, 100]);
        }
    }
    let narrow = Image::new(
        WIDTH / 2,
        HEIGHT,
        Channels::Rgb,
        &halves[..WIDTH / 2 * HEIGHT * 3],
    )
    .unwrap();
    let mut fusion = Fusion::new(settings(0.05)).unwrap();
    let error = fusion.integrate(&Frame {
        image: Some(&narrow),
        ..frame(&depth, &camera)
    });
    assert!(matches!(error, Err(Error::Sizes { other: "image", .. })));
}

/// Returns all numbers of a mesh as bits.
fn bits(mesh: &Mesh) -> Vec<u64> {
    let positions = mesh.positions.iter().flatten().map(|v| v.to_bits());
    let normals = mesh.normals.iter().flatten().map(|v| v.to_bits().into());
    let triangles = mesh.triangles.iter().flatten().map(|v| u64::from(*v));
    positions.chain(normals).chain(triangles).collect()
}

#[test]
fn threads_change_no_bit_and_powers_of_two_only_the_scale() {
    let fused = |threads: usize, scale: f64| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let (cameras, maps) = views_of_a_sphere(0.5 * scale);
        let mut random = lsdc_rng::Rng::stream(7, &["noise"]);
        let noisy: Vec<DepthMap> = maps
            .iter()
            .map(|map| {
                let noise = |depth: &f32| depth * (1.0 + 0.003 * random.normal());
                DepthMap::new(WIDTH, HEIGHT, map.values().iter().map(noise).collect()).unwrap()
            })
            .collect();
        let frames: Vec<Frame<'_>> = noisy
            .iter()
            .zip(&cameras)
            .map(|(d, c)| frame(d, c))
            .collect();
        pool.install(|| fused(settings(0.03 * scale), &frames).mesh().unwrap())
    };
    let mesh = fused(1, 1.0);
    assert!(mesh.triangles.len() > 1000);
    assert!(bits(&mesh) == bits(&fused(2, 1.0)), "threads");
    let mut large = fused(2, 4.0);
    large.positions.iter_mut().flatten().for_each(|v| *v /= 4.0);
    assert!(bits(&mesh) == bits(&large), "scale");
}

#[test]
fn memory_is_bounded_and_an_error_changes_nothing() {
    let (cameras, maps) = views_of_a_sphere(0.5);
    let enough = fused(settings(0.02), &[frame(&maps[0], &cameras[0])]);
    let limit = Settings {
        max_memory: enough.report().memory,
        ..settings(0.02)
    };
    let mut fusion = Fusion::new(limit).unwrap();
    fusion.integrate(&frame(&maps[0], &cameras[0])).unwrap();
    let (mesh, report) = (fusion.mesh().unwrap(), fusion.report().clone());
    let error = fusion.integrate(&frame(&maps[1], &cameras[1])).unwrap_err();
    assert!(matches!(error, Error::Memory { edge: 0.02, .. }), "{error}");
    assert!(error.hint().is_some());
    assert_eq!((fusion.mesh().unwrap(), fusion.report()), (mesh, &report));
    // The same frame still fits, also repeatedly.
    fusion.integrate(&frame(&maps[0], &cameras[0])).unwrap();
    assert_eq!(fusion.report().blocks, report.blocks);
}

#[test]
fn what_cannot_be_fused_is_refused() {
    for (setting, bad) in [
        (
            "voxel",
            Settings {
                voxel: Some(0.0),
                ..Settings::default()
            },
        ),
        (
            "truncation_voxels",
            Settings {
                truncation_voxels: [1.0, 4.0],
                ..Settings::default()
            },
        ),
        (
            "max_angle",
            Settings {
                max_angle: 120.0,
                ..Settings::default()
            },
        ),
    ] {
        let error = Fusion::new(bad).unwrap_err();
        assert!(matches!(error, Error::Setting { setting: found, .. } if found == setting));
    }
    let mut fusion = Fusion::new(Settings::default()).unwrap();
    assert!(matches!(fusion.mesh(), Err(Error::NoFrames)));
    let camera = looking([0.0; 3], [0.0, 0.0, 1.0]);
    let empty = DepthMap::empty(WIDTH, HEIGHT);
    assert!(matches!(
        fusion.integrate(&frame(&empty, &camera)),
        Err(Error::NoPixels)
    ));
    let mirrored = camera.clone().with_pose(
        [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        [0.0; 3],
    );
    let depth = DepthMap::new(WIDTH, HEIGHT, vec![2.0; WIDTH * HEIGHT]).unwrap();
    assert!(matches!(
        fusion.integrate(&frame(&depth, &mirrored)),
        Err(Error::Core(_))
    ));
    let short = Frame {
        deviation: Some(&[0.1; 7]),
        ..frame(&depth, &camera)
    };
    assert!(matches!(fusion.integrate(&short), Err(Error::Sizes { .. })));
    // Depths beyond the range of block indices.
    let far = DepthMap::new(WIDTH, HEIGHT, vec![1e30; WIDTH * HEIGHT]).unwrap();
    let mut fusion = Fusion::new(settings(0.01)).unwrap();
    fusion.integrate(&frame(&far, &camera)).unwrap();
    assert_eq!(fusion.report().left_out.far, WIDTH * HEIGHT);
    assert!(fusion.mesh().unwrap().positions.is_empty());
}
