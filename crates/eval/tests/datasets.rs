//! Datasets written to disk in each layout and read back exactly.

#![allow(clippy::unwrap_used)]

#[path = "../../../tests/scans/mod.rs"]
mod scans;

use hdf5_pure::FileBuilder;
use image::{ImageBuffer, Luma, Rgb, RgbImage};
use lsdc_eval::data::{
    DataConfig, Dataset, DatasetKind, DepthMap, Depths, DiodeConfig, Environment, FolderConfig,
    Frame, NyuConfig, Split, write_depth_png, write_npy, write_rgb,
};
use scans::write_list;
use std::path::{Path, PathBuf};
use std::sync::Arc;

const WIDTH: usize = 12;
const HEIGHT: usize = 9;

/// Frame `i`: depths in whole millimetres, so that every format can represent them.
fn frame(i: usize) -> (RgbImage, DepthMap) {
    let rgb = RgbImage::from_fn(WIDTH as u32, HEIGHT as u32, |x, y| {
        Rgb([(x * 20) as u8, (y * 25 + 3) as u8, (i * 40) as u8])
    });
    let millimetres = (0..WIDTH * HEIGHT).map(|k| 700 + 37 * k + 11 * i);
    let depths = millimetres.map(|mm| (mm as f64 * 0.001) as f32).collect();
    (rgb, DepthMap::new(WIDTH, HEIGHT, depths).unwrap())
}

fn open(
    kind: DatasetKind,
    root: &Path,
    split: Split,
) -> lsdc_files::error::Result<Arc<dyn Dataset>> {
    let config = DataConfig {
        dataset: kind,
        root: Some(root.to_owned()),
        ..DataConfig::default()
    };
    config.open(split, None)
}

fn file(root: &Path, name: &str) -> PathBuf {
    let path = root.join(name);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    path
}

fn same(found: &Frame, i: usize) {
    let (rgb, depth) = frame(i);
    assert_eq!(found.rgb, rgb, "{}", found.id);
    assert_eq!(found.depth, depth, "{}", found.id);
}

/// Returns three row-major planes, as in sparse-to-dense files.
fn planes(rgb: &RgbImage) -> Vec<u8> {
    (0..3)
        .flat_map(|c| rgb.pixels().map(move |p| p[c]))
        .collect()
}

/// Returns three column-major planes, as in MATLAB files.
fn columns(rgb: &RgbImage) -> Vec<u8> {
    (0..3)
        .flat_map(|c| (0..rgb.width()).flat_map(move |x| (0..rgb.height()).map(move |y| (c, x, y))))
        .map(|(c, x, y)| rgb.get_pixel(x, y)[c])
        .collect()
}

fn write_h5(path: &Path, i: usize, filter: usize) {
    let (rgb, depth) = frame(i);
    let mut builder = FileBuilder::new();
    let shape = [HEIGHT as u64, WIDTH as u64];
    let dataset = builder.create_dataset("rgb").with_u8_data(&planes(&rgb));
    let dataset = dataset.with_shape(&[3, shape[0], shape[1]]);
    match filter {
        0 => dataset,
        1 => dataset.with_chunks(&[1, 4, 5]).with_deflate(4),
        2 => dataset
            .with_chunks(&[2, 9, 6])
            .with_shuffle()
            .with_deflate(4),
        _ => dataset.with_chunks(&[3, 3, 12]).with_lzf(),
    };
    let dataset = builder
        .create_dataset("depth")
        .with_f32_data(depth.values());
    let dataset = dataset.with_shape(&shape);
    match filter {
        0 => dataset,
        1 => dataset.with_chunks(&[4, 5]).with_deflate(4),
        2 => dataset.with_chunks(&[9, 6]).with_shuffle().with_deflate(4),
        _ => dataset.with_chunks(&[3, 12]).with_lzf(),
    };
    builder.write(path).unwrap();
}

/// Writes a labelled file of `count` frames; raw depths lack every seventh pixel.
fn write_mat(path: &Path, count: usize) {
    let mut builder = FileBuilder::new();
    builder.with_userblock(512);
    builder.with_userblock_content(b"MATLAB 7.3 MAT-file");
    let frames: Vec<_> = (0..count).map(frame).collect();
    let colours: Vec<u8> = frames.iter().flat_map(|(rgb, _)| columns(rgb)).collect();
    let depths = |holes: bool| -> Vec<f32> {
        let of = |depth: &DepthMap| -> Vec<f32> {
            (0..WIDTH * HEIGHT)
                .map(|i| (i / HEIGHT, i % HEIGHT, i))
                .map(|(x, y, i)| {
                    if holes && i % 7 == 0 {
                        0.0
                    } else {
                        depth.at(x, y)
                    }
                })
                .collect()
        };
        frames.iter().flat_map(|(_, depth)| of(depth)).collect()
    };
    let shape = [count as u64, WIDTH as u64, HEIGHT as u64];
    builder
        .create_dataset("images")
        .with_u8_data(&colours)
        .with_shape(&[shape[0], 3, shape[1], shape[2]])
        .with_chunks(&[1, 3, shape[1], shape[2]])
        .with_deflate(3);
    for (name, holes) in [("depths", false), ("rawDepths", true)] {
        builder
            .create_dataset(name)
            .with_f32_data(&depths(holes))
            .with_shape(&shape)
            .with_chunks(&[1, shape[1], shape[2]])
            .with_deflate(3);
    }
    builder.write(path).unwrap();
}

#[test]
fn nyu_is_the_same_in_every_form() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    // Official test frames 1, 2, 9 and 14.
    let official = [1, 2, 9, 14];
    for (i, n) in official.into_iter().enumerate() {
        let (rgb, depth) = frame(i);
        write_h5(
            &file(folder.path(), &format!("h5/val/official/{n:05}.h5")),
            i,
            i,
        );
        let tree = |name: String| file(folder.path(), &name);
        for (image, truth) in [
            (
                format!("bts/kitchen/rgb_{:05}.jpg", n - 1),
                format!("bts/kitchen/sync_depth_{:05}.png", n - 1),
            ),
            (
                format!("marigold/test/kitchen/rgb_{n:04}.png"),
                format!("marigold/test/kitchen/filled_{n:04}.png"),
            ),
            (
                format!("dense/{:05}_colors.png", n - 1),
                format!("dense/{:05}_depth.png", n - 1),
            ),
            (
                format!("png/val/kitchen/{n:05}.jpg"),
                format!("png/val/kitchen/{n:05}_depth.png"),
            ),
        ] {
            // A PNG with the name of a JPEG: the content determines the format, and is lossless.
            let scratch = tree(format!("{image}.png"));
            write_rgb(&scratch, &rgb).unwrap();
            std::fs::rename(scratch, tree(image)).unwrap();
            write_depth_png(&tree(truth), &depth, 0.001).unwrap();
        }
    }
    for (form, words) in [
        ("h5", "sparse-to-dense"),
        ("bts", "BTS"),
        ("marigold", "Marigold"),
        ("dense", "DenseDepth"),
        ("png", "JPEG and 16-bit PNG"),
    ] {
        let frames = open(DatasetKind::Nyu, &at(form), Split::Val).unwrap();
        assert!(
            frames.description().contains(words),
            "{form}: {}",
            frames.description()
        );
        assert_eq!(frames.len(), 4, "{form}");
        for (i, n) in official.into_iter().enumerate() {
            assert_eq!(frames.id(i), format!("{n:05}"), "{form}");
            same(&frames.load(i).unwrap(), i);
        }
    }
}

#[test]
fn the_labelled_file_follows_the_official_split() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("nyu_depth_v2_labeled.mat");
    write_mat(&path, 1449);
    let frames = open(DatasetKind::Nyu, folder.path(), Split::Val).unwrap();
    assert_eq!(frames.len(), 654);
    assert!(frames.description().contains("official split"));
    // The third test frame has the official number 9.
    assert_eq!(frames.id(2), "00009");
    same(&frames.load(2).unwrap(), 8);

    let raw = DataConfig {
        dataset: DatasetKind::Nyu,
        root: Some(path),
        nyu: NyuConfig {
            depths: Depths::Raw,
        },
        ..DataConfig::default()
    };
    let raw = raw.open(Split::Val, None).unwrap().load(0).unwrap();
    assert_eq!(
        raw.depth.count(),
        WIDTH * HEIGHT - (WIDTH * HEIGHT).div_ceil(7)
    );
    assert_eq!(
        (raw.depth.at(0, 0), raw.depth.at(0, 1)),
        (0.0, frame(0).1.at(0, 1))
    );

    let small = tempfile::tempdir().unwrap();
    write_mat(&small.path().join("part.mat"), 3);
    let frames = open(DatasetKind::Nyu, small.path(), Split::Val).unwrap();
    assert_eq!(frames.len(), 3);
    same(&frames.load(1).unwrap(), 1);
    assert!(open(DatasetKind::Nyu, small.path(), Split::Train).is_err());
}

#[test]
fn the_crops_of_conti_bring_their_points() {
    let folder = tempfile::tempdir().unwrap();
    let (rgb, depth) = frame(3);
    let shape = [1, HEIGHT as u64, WIDTH as u64];
    let mut builder = FileBuilder::new();
    builder
        .create_dataset("img")
        .with_u8_data(rgb.as_raw())
        .with_shape(&[1, shape[1], shape[2], 3]);
    builder
        .create_dataset("gt")
        .with_f32_data(depth.values())
        .with_shape(&shape);
    builder.write(folder.path().join("nyu_img_gt.h5")).unwrap();
    let mut points = vec![0.0; WIDTH * HEIGHT];
    points[17] = 2.5;
    let mut builder = FileBuilder::new();
    builder
        .create_dataset("hints")
        .with_f32_data(&points)
        .with_shape(&shape);
    builder
        .write(folder.path().join("nyu_pred_with_500.h5"))
        .unwrap();
    let frames = open(DatasetKind::Nyu, folder.path(), Split::Val).unwrap();
    let found = frames.load(0).unwrap();
    same(&found, 3);
    assert_eq!(found.sparse.unwrap().values(), points);
}

/// Writes a boolean, float32 or float64 mask in which every fifth pixel is invalid.
fn write_mask(path: &Path, kind: usize) {
    use npyz::WriterBuilder as _;
    let shape = [HEIGHT as u64, WIDTH as u64];
    let valid = (0..WIDTH * HEIGHT).map(|i| i % 5 != 0);
    let mut file = Vec::new();
    macro_rules! write {
        ($t:ty, $of:expr) => {{
            let options = npyz::WriteOptions::<$t>::new()
                .default_dtype()
                .shape(&shape);
            let mut writer = options.writer(&mut file).begin_nd().unwrap();
            writer.extend(valid.map($of)).unwrap();
            writer.finish().unwrap();
        }};
    }
    match kind {
        0 => write!(bool, |v| v),
        1 => write!(f32, f32::from),
        _ => write!(f64, f64::from),
    }
    std::fs::write(path, file).unwrap();
}

#[test]
fn diode_is_found_by_its_list_or_by_walking() {
    let folder = tempfile::tempdir().unwrap();
    let names = [
        "00019_00183_indoors_000_000",
        "00019_00183_indoors_000_010",
        "00022_00193_outdoor_000_000",
    ];
    for (i, name) in names.into_iter().enumerate() {
        let place = if name.contains("indoors") {
            "indoors"
        } else {
            "outdoor"
        };
        let scene = &name[..5];
        let scan = &name[6..11];
        let (rgb, depth) = frame(i);
        let stem = format!("val/{place}/scene_{scene}/scan_{scan}/{name}");
        write_rgb(&file(folder.path(), &format!("{stem}.png")), &rgb).unwrap();
        write_npy(&file(folder.path(), &format!("{stem}_depth.npy")), &depth).unwrap();
        write_mask(&file(folder.path(), &format!("{stem}_depth_mask.npy")), i);
    }
    let check = |words: &str| {
        let frames = open(DatasetKind::Diode, folder.path(), Split::Val).unwrap();
        assert!(
            frames.description().contains(words),
            "{}",
            frames.description()
        );
        assert_eq!(frames.len(), 3);
        for i in 0..3 {
            let found = frames.load(i).unwrap();
            same(&found, i);
            assert_eq!(
                found.place,
                if i < 2 {
                    Environment::Indoor
                } else {
                    Environment::Outdoor
                }
            );
            let mask = found.mask.unwrap();
            assert!(
                mask.iter()
                    .enumerate()
                    .all(|(k, valid)| *valid == (k % 5 != 0))
            );
        }
    };
    check("as found");
    let meta = r#"{"train":{},"val":{
        "indoors":{"scene_00019":{"scan_00183":["00019_00183_indoors_000_000","00019_00183_indoors_000_010"]}},
        "outdoor":{"scene_00022":{"scan_00193":["00022_00193_outdoor_000_000"]}}}}"#;
    std::fs::write(folder.path().join("diode_meta.json"), meta).unwrap();
    check("by diode_meta.json");
    let outdoor = DataConfig {
        dataset: DatasetKind::Diode,
        root: Some(folder.path().to_owned()),
        diode: DiodeConfig {
            place: Some(Environment::Outdoor),
        },
        ..DataConfig::default()
    };
    assert_eq!(outdoor.open(Split::Val, None).unwrap().len(), 1);
    assert!(open(DatasetKind::Diode, folder.path(), Split::Train).is_err());
}

/// Writes depths in units of 1/256 m.
fn write_256(path: &Path, units: impl Fn(usize) -> u16) {
    let values = (0..WIDTH * HEIGHT).map(units).collect();
    let image: ImageBuffer<Luma<u16>, Vec<u16>> =
        ImageBuffer::from_raw(WIDTH as u32, HEIGHT as u32, values).unwrap();
    image.save(path).unwrap();
}

fn laser(k: usize) -> u16 {
    if k % 9 == 4 { 512 } else { 0 }
}

#[test]
fn kitti_is_read_in_both_layouts() {
    let folder = tempfile::tempdir().unwrap();
    let drive = "2011_09_26_drive_0002_sync";
    let selection = "depth_selection/val_selection_cropped";
    let tree = format!("val/{drive}");
    for (root, image, truth, points) in [
        (
            "cropped",
            format!("{selection}/image/{drive}_image_0000000005_image_02.png"),
            format!(
                "{selection}/groundtruth_depth/{drive}_groundtruth_depth_0000000005_image_02.png"
            ),
            format!("{selection}/velodyne_raw/{drive}_velodyne_raw_0000000005_image_02.png"),
        ),
        (
            "full",
            format!("{tree}/image_02/data/0000000005.png"),
            format!("{tree}/proj_depth/groundtruth/image_02/0000000005.png"),
            format!("{tree}/proj_depth/velodyne_raw/image_02/0000000005.png"),
        ),
    ] {
        let root = folder.path().join(root);
        write_rgb(&file(&root, &image), &frame(1).0).unwrap();
        write_256(&file(&root, &truth), |k| (256 + k) as u16);
        write_256(&file(&root, &points), laser);
        let frames = open(DatasetKind::Kitti, &root, Split::Val).unwrap();
        assert_eq!(frames.len(), 1);
        let found = frames.load(0).unwrap();
        assert_eq!(found.place, Environment::Outdoor);
        assert_eq!(found.rgb, frame(1).0);
        assert_eq!(found.depth.at(3, 2), 1.0 + (2 * WIDTH + 3) as f32 / 256.0);
        let points = found.sparse.unwrap();
        assert_eq!(points.count(), 12);
        assert!(points.points().all(|p| p.depth == 2.0));
    }
}

#[test]
fn void_follows_its_list() {
    let folder = tempfile::tempdir().unwrap();
    for stamp in ["1552625661.3050", "1552625662.3050"] {
        for (kind, units) in [("sparse_depth", 0_u16), ("ground_truth", 600)] {
            let path = file(
                folder.path(),
                &format!("data/classroom0/{kind}/{stamp}.png"),
            );
            write_256(&path, |k| if units == 0 { laser(k) } else { units });
        }
        let path = file(folder.path(), &format!("data/classroom0/image/{stamp}.png"));
        write_rgb(&path, &frame(0).0).unwrap();
    }
    assert_eq!(
        open(DatasetKind::Void, folder.path(), Split::Val)
            .unwrap()
            .len(),
        2
    );
    let list = "void_release/void_1500/data/classroom0/image/1552625662.3050.png\n";
    std::fs::write(folder.path().join("test_image.txt"), list).unwrap();
    let frames = open(DatasetKind::Void, folder.path(), Split::Val).unwrap();
    assert_eq!(frames.len(), 1);
    let found = frames.load(0).unwrap();
    assert!(found.depth.values().iter().all(|v| *v == 600.0 / 256.0));
    assert_eq!(found.sparse.unwrap().count(), 12);
}

#[test]
fn tum_pairs_images_and_depths() {
    let folder = tempfile::tempdir().unwrap();
    for (i, name) in ["1.01", "1.05"].into_iter().enumerate() {
        let (rgb, depth) = frame(i);
        write_rgb(&file(folder.path(), &format!("rgb/{name}.png")), &rgb).unwrap();
        write_depth_png(
            &file(folder.path(), &format!("depth/{name}.png")),
            &depth,
            0.0002,
        )
        .unwrap();
    }
    let list = |kind: &str| format!("# time file\n1.01 {kind}/1.01.png\n1.05 {kind}/1.05.png\n");
    std::fs::write(folder.path().join("rgb.txt"), list("rgb")).unwrap();
    std::fs::write(folder.path().join("depth.txt"), list("depth")).unwrap();
    let frames = open(DatasetKind::Tum, folder.path(), Split::Val).unwrap();
    assert_eq!(frames.len(), 2);
    same(&frames.load(1).unwrap(), 1);
    // Depth first, as in ICL-NUIM.
    for one in [
        "1.05 rgb/1.05.png 1.05 depth/1.05.png\n",
        "1.05 depth/1.05.png 1.05 rgb/1.05.png\n",
    ] {
        std::fs::write(folder.path().join("associations.txt"), one).unwrap();
        let frames = open(DatasetKind::Tum, folder.path(), Split::Val).unwrap();
        assert_eq!((frames.len(), &*frames.id(0)), (1, "1.05"));
        same(&frames.load(0).unwrap(), 1);
    }
    let colours = "1.05 rgb/1.05.png 1.05 rgb/1.01.png\n";
    std::fs::write(folder.path().join("associations.txt"), colours).unwrap();
    let error = open(DatasetKind::Tum, folder.path(), Split::Val)
        .err()
        .unwrap();
    assert!(error.to_string().contains("both hold colours"), "{error}");
}

#[test]
fn a_loose_template_takes_no_depth_for_a_colour() {
    let folder = tempfile::tempdir().unwrap();
    let (rgb, depth) = frame(1);
    write_rgb(&folder.path().join("a.png"), &rgb).unwrap();
    write_depth_png(&folder.path().join("a_depth.png"), &depth, 0.001).unwrap();
    let config = DataConfig {
        dataset: DatasetKind::Folder,
        root: Some(folder.path().to_owned()),
        folder: FolderConfig {
            rgb: "{frame}.png".into(),
            depth: "{frame}_depth.png".into(),
            ..FolderConfig::default()
        },
        ..DataConfig::default()
    };
    let frames = config.open(Split::Val, None).unwrap();
    assert_eq!(frames.len(), 1);
    same(&frames.load(0).unwrap(), 1);
}

#[test]
fn a_place_without_the_dataset_is_an_error_that_helps() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir_all(folder.path().join("rgb")).unwrap();
    for kind in DatasetKind::ALL {
        if kind == DatasetKind::Rooms {
            continue;
        }
        let Err(error) = open(kind, folder.path(), Split::Val) else {
            panic!("{} opened an empty folder", kind.name());
        };
        let helps = error.advice().is_some() || error.to_string().contains("rgb.txt");
        assert!(helps, "{}: {error}", kind.name());
    }
}

/// Regression test: export wrote one file for two frames with the same name.
#[test]
fn two_scenes_of_nyu_with_frames_of_one_number_keep_their_names() {
    let folder = tempfile::tempdir().unwrap();
    for (i, scene) in ["kitchen", "office"].into_iter().enumerate() {
        let path = file(folder.path(), &format!("val/{scene}/00001.h5"));
        write_h5(&path, i, 0);
    }
    let frames = open(DatasetKind::Nyu, folder.path(), Split::Val).unwrap();
    let names: Vec<_> = (0..frames.len()).map(|i| frames.id(i)).collect();
    assert_eq!(names, ["kitchen/00001", "office/00001"]);
}

#[test]
fn frames_that_share_a_name_are_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let (rgb, depth) = frame(0);
    for split in ["val", "test"] {
        write_rgb(&file(folder.path(), &format!("{split}/a.png")), &rgb).unwrap();
        let path = file(folder.path(), &format!("{split}/a_depth.png"));
        write_depth_png(&path, &depth, 0.001).unwrap();
    }
    let config = DataConfig {
        dataset: DatasetKind::Folder,
        root: Some(folder.path().to_owned()),
        folder: FolderConfig {
            rgb: "{split}/{frame}.png".into(),
            ..FolderConfig::default()
        },
        ..DataConfig::default()
    };
    let error = config.open(Split::Val, None).err().unwrap().to_string();
    assert!(error.contains("two frames are called `a`"), "{error}");
}

#[test]
fn names_of_a_list_cannot_lead_out_of_the_folder() {
    let folder = tempfile::tempdir().unwrap();
    for (scene, scan, name) in [
        ("s", "t", "../../../out"),
        ("s", "t", "/tmp/out"),
        ("..", "t", "f"),
        ("s", "a/../../b", "f"),
    ] {
        let list = format!(r#"{{"val":{{"indoors":{{"{scene}":{{"{scan}":["{name}"]}}}}}}}}"#);
        std::fs::write(folder.path().join("diode_meta.json"), list).unwrap();
        let error = open(DatasetKind::Diode, folder.path(), Split::Val);
        let error = error.err().unwrap().to_string();
        assert!(error.contains("cannot be the name of a frame"), "{error}");
    }
}

#[test]
fn depths_of_any_folder_are_metres_but_for_png() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| file(folder.path(), name);
    let (rgb, depth) = frame(0);
    write_rgb(&at("colours/a.png"), &rgb).unwrap();
    write_npy(&at("depths/a.npy"), &depth).unwrap();
    write_depth_png(&at("depths/a.png"), &depth, 0.001).unwrap();
    for (ending, depth_scale, factor) in [
        ("npy", None, 1.0),
        ("png", None, 1.0),
        ("npy", Some(0.5), 0.5),
    ] {
        let config = DataConfig {
            dataset: DatasetKind::Folder,
            root: Some(folder.path().to_owned()),
            folder: FolderConfig {
                rgb: "colours/{frame}.png".into(),
                depth: format!("depths/{{frame}}.{ending}"),
                depth_scale,
                ..FolderConfig::default()
            },
            ..DataConfig::default()
        };
        let frames = config.open(Split::Val, None).unwrap();
        let found = frames.load(0).unwrap();
        for (found, true_depth) in found.depth.values().iter().zip(depth.values()) {
            assert!((found - factor * true_depth).abs() < 1e-5, "{ending}");
        }
    }
}

#[test]
fn scans_are_returns_rounded_to_pixels() {
    let folder = tempfile::tempdir().unwrap();
    let (rgb, _) = frame(3);
    let returns = [
        (0.0, 0.0, 4.0, 5),
        // Pixels extend from -0.5 to 0.5.
        (-0.5, 0.49, 6.0, 7),
        (3.5, 2.4, 8.0, -1),
        (4.4, 1.6, 7.0, 3),
        (11.49, 8.49, 70.0, 0),
        (11.5, 8.0, 1.0, 0),
        (2.0, -0.6, 1.0, 0),
        (f32::NAN, 2.0, 1.0, 0),
        (5.0, 5.0, f32::INFINITY, 1),
        (6.0, 5.0, -2.0, 1),
    ];
    scans::write_scan(folder.path(), "town/a", &rgb, &returns);
    scans::write_scan(folder.path(), "b", &rgb, &[(1.0, 1.0, 2.0, -1)]);
    write_rgb(&file(folder.path(), "town/alone.png"), &rgb).unwrap();
    let frames = open(DatasetKind::Scans, folder.path(), Split::Val).unwrap();
    assert_eq!(
        (0..frames.len()).map(|i| frames.id(i)).collect::<Vec<_>>(),
        ["b", "town/a"]
    );
    assert_eq!(frames.protocol(), "scans");
    let about = frames.description();
    let counts =
        "11 returns; left out: 3 outside of the image, 2 without a positive depth, 2 behind";
    assert!(about.contains(counts), "{about}");
    let scan = frames.load(1).unwrap();
    assert_eq!((&scan.rgb, scan.place), (&rgb, Environment::Outdoor));
    let found: Vec<_> = scan.depth.points().map(|p| (p.x, p.y, p.depth)).collect();
    assert_eq!(found, [(0, 0, 4.0), (4, 2, 7.0), (11, 8, 70.0)]);
    assert_eq!(scan.sparse.as_ref(), Some(&scan.depth));
    let rings = scan.rings.unwrap();
    assert_eq!(
        [0, 2 * WIDTH + 4, 8 * WIDTH + 11].map(|i| rings[i]),
        [5, 3, 0]
    );
    assert_eq!(rings.iter().filter(|ring| **ring >= 0).count(), 3);
    assert_eq!(frames.load(0).unwrap().rings.unwrap(), [-1; WIDTH * HEIGHT]);
}

#[test]
fn broken_scans_are_errors_of_their_frame() {
    let folder = tempfile::tempdir().unwrap();
    let (rgb, _) = frame(0);
    let said = |write: &dyn Fn(&mut zip::ZipWriter<std::fs::File>)| {
        scans::write_scan(folder.path(), "a", &rgb, &[]);
        let path = folder.path().join("a_points.npz");
        let mut archive = zip::ZipWriter::new(std::fs::File::create(&path).unwrap());
        write(&mut archive);
        archive.finish().unwrap();
        let frames = open(DatasetKind::Scans, folder.path(), Split::Val).unwrap();
        assert!(frames.description().contains("0 returns"));
        let error = frames.load(0).unwrap_err();
        assert_eq!(error.cause(), lsdc_files::error::Cause::Format);
        error.to_string()
    };
    let places = |archive: &mut zip::ZipWriter<std::fs::File>| {
        write_list(archive, "u", [1.0_f32, 2.0].into_iter());
        write_list(archive, "v", [1.0_f64, 2.0].into_iter());
    };
    let missing = said(&places);
    assert!(missing.contains("no array `depth`"), "{missing}");
    let lengths = said(&|archive| {
        places(archive);
        write_list(archive, "depth", [1.0_f32].into_iter());
    });
    assert!(
        lengths.contains("2 values of `u` but 1 of `depth`"),
        "{lengths}"
    );
    let rings = said(&|archive| {
        places(archive);
        write_list(archive, "depth", [1_i32, 2].into_iter());
        write_list(archive, "ring", [1.0_f32, 2.0].into_iter());
    });
    assert!(rings.contains("rings that are no integers"), "{rings}");
    let nothing = said(&|archive| {
        places(archive);
        write_list(archive, "depth", [-1.0_f32, f32::NAN].into_iter());
    });
    assert!(nothing.contains("no return that can be used"), "{nothing}");
    std::fs::write(folder.path().join("a_points.npz"), b"PK no archive").unwrap();
    let frames = open(DatasetKind::Scans, folder.path(), Split::Val).unwrap();
    let error = frames.load(0).unwrap_err().to_string();
    assert!(error.contains("no sound npz archive"), "{error}");
    std::fs::remove_file(folder.path().join("a.png")).unwrap();
    let error = open(DatasetKind::Scans, folder.path(), Split::Val);
    let error = error.err().unwrap().to_string();
    assert!(error.contains("no laser scan"), "{error}");
}
