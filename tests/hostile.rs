//! Damaged files of every format give an error or a result, never a panic or excessive memory use.
//!
//! `LSDC_DAMAGED=20000 cargo test --release --test hostile` tries more copies than the default of a few hundred.

#![allow(clippy::unwrap_used)]

mod scans;

use hdf5_pure::FileBuilder;
use image::{Rgb, RgbImage};
use lsdc_eval::data::{
    Camera, Colmap, ColoredPoint, DataConfig, DatasetKind, DepthMap, Sparse, Split, read_depth,
    read_mask, read_rgb, write_depth_png, write_exr, write_npy, write_npz, write_pfm, write_ply,
    write_rgb, write_tiff,
};
use lsdc_eval::report::EvaluationReport;
use lsdc_paper::systems::{Predictor, SystemConfig, SystemWeights};
use lsdc_recordings::fuzzing::message;
use lsdc_recordings::{Defects, FrameOptions, Frames, MessageType, Recording, Survey};
use lsdc_rng::Rng;
use lsdc_train::device::Device;
use lsdc_weights::Precision;
use lsdc_weights::read_encoder;
use pcd_rs::{DataKind, DynRecord, DynWriter, Field, ValueKind, WriterInit};
use std::alloc::{GlobalAlloc, Layout, System};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Allocator that counts allocated bytes.
struct Counting;

static IN_USE: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

/// Serialises the tests of this file, so that each measures only its own memory.
static TURN: Mutex<()> = Mutex::new(());

#[allow(unsafe_code)]
// SAFETY: every call is forwarded to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let now = IN_USE.fetch_add(layout.size(), Ordering::Relaxed) + layout.size();
        PEAK.fetch_max(now, Ordering::Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        IN_USE.fetch_sub(layout.size(), Ordering::Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Limit of the bytes allocated while reading a file of a few kilobytes.
const MOST: usize = 48 << 20;

const WIDTH: usize = 24;
const HEIGHT: usize = 18;

fn copies() -> u64 {
    let asked = std::env::var("LSDC_DAMAGED").ok();
    asked.and_then(|n| n.parse().ok()).unwrap_or(300)
}

fn rgb() -> RgbImage {
    RgbImage::from_fn(WIDTH as u32, HEIGHT as u32, |x, y| {
        Rgb([(x * 9) as u8, (y * 13) as u8, (x * y) as u8])
    })
}

fn depth() -> DepthMap {
    let values = (0..WIDTH * HEIGHT).map(|i| 1.0 + i as f32 * 0.01).collect();
    DepthMap::new(WIDTH, HEIGHT, values).unwrap()
}

/// Returns a copy with some bits flipped, some bytes or numbers replaced, or its end missing.
fn damaged(sound: &[u8], rng: &mut Rng) -> Vec<u8> {
    let mut copy = sound.to_vec();
    let kind = rng.below(4);
    if kind == 0 {
        copy.truncate(rng.below(sound.len() as u32) as usize);
        return copy;
    }
    // Damage the front, where headers are, more often.
    let reach = if rng.chance(0.5) {
        copy.len().min(512)
    } else {
        copy.len()
    };
    for _ in 0..=rng.below(6) {
        let at = rng.below(reach as u32) as usize;
        match kind {
            1 => copy[at] ^= 1 << rng.below(8),
            2 => copy[at] = rng.below(256) as u8,
            _ => {
                let huge = [0xff, 0xff, 0xff, 0x7f, 0, 0, 0, 0];
                let end = (at + 1 + rng.below(8) as usize).min(copy.len());
                copy[at..end].copy_from_slice(&huge[..end - at]);
            }
        }
    }
    copy
}

/// Reads the sound file, which must succeed, and damaged copies, which must not panic or exceed the memory limit.
fn survive(path: &Path, read: impl Fn() -> bool) {
    let _turn = TURN
        .lock()
        .unwrap_or_else(std::sync::PoisonError::into_inner);
    let name = path.file_name().unwrap().to_string_lossy().into_owned();
    let sound = std::fs::read(path).unwrap();
    assert!(read(), "the sound {name} cannot be read");
    let mut refused = 0;
    for i in 0..copies() {
        let mut rng = Rng::stream(i, &["damage", &name]);
        std::fs::write(path, damaged(&sound, &mut rng)).unwrap();
        let before = IN_USE.load(Ordering::Relaxed);
        PEAK.store(before, Ordering::Relaxed);
        let outcome = catch_unwind(AssertUnwindSafe(&read));
        let taken = PEAK.load(Ordering::Relaxed) - before;
        let kept = Path::new(env!("CARGO_TARGET_TMPDIR")).join(&name);
        if taken >= MOST || outcome.is_err() {
            std::fs::copy(path, &kept).unwrap();
        }
        let kept = kept.display();
        assert!(
            taken < MOST,
            "copy {i}: {} MiB, kept as {kept}",
            taken >> 20
        );
        let Ok(fine) = outcome else {
            panic!("copy {i}: panicked, kept as {kept}");
        };
        refused += u64::from(!fine);
    }
    assert!(refused > 0, "no damage of {name} was noticed");
}

/// Whether every frame of a dataset can be read.
fn readable(kind: DatasetKind, root: &Path) -> bool {
    let config = DataConfig {
        dataset: kind,
        root: Some(root.to_owned()),
        ..DataConfig::default()
    };
    config
        .open(Split::Val, None)
        .is_ok_and(|frames| (0..frames.len()).all(|i| frames.load(i).is_ok()))
}

#[test]
fn images() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("colour.png");
    write_rgb(&path, &rgb()).unwrap();
    survive(&path, || read_rgb(&path).is_ok());
    let path = folder.path().join("colour.jpg");
    rgb().save(&path).unwrap();
    survive(&path, || read_rgb(&path).is_ok());
    let path = folder.path().join("depth.png");
    write_depth_png(&path, &depth(), 0.001).unwrap();
    survive(&path, || read_depth(&path, 0.001).is_ok());
}

#[test]
fn arrays() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("depth.npy");
    write_npy(&path, &depth()).unwrap();
    survive(&path, || read_depth(&path, 1.0).is_ok());
    survive_mask(&folder.path().join("mask.npy"));
}

fn survive_mask(path: &Path) {
    use npyz::WriterBuilder as _;
    let mut file = Vec::new();
    let options = npyz::WriteOptions::<bool>::new().default_dtype();
    let shape = [HEIGHT as u64, WIDTH as u64, 1];
    let mut writer = options.shape(&shape).writer(&mut file).begin_nd().unwrap();
    writer
        .extend((0..WIDTH * HEIGHT).map(|i| i % 3 > 0))
        .unwrap();
    writer.finish().unwrap();
    std::fs::write(path, file).unwrap();
    survive(path, || read_mask(path).is_ok());
}

#[test]
fn hierarchical_files() {
    let folder = tempfile::tempdir().unwrap();
    let (width, height) = (WIDTH as u64, HEIGHT as u64);
    for filter in 0..3 {
        let root = folder.path().join(format!("tree{filter}"));
        let path = root.join("val/official/00001.h5");
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        let mut builder = FileBuilder::new();
        let rgb = builder
            .create_dataset("rgb")
            .with_u8_data(&[7; 3 * WIDTH * HEIGHT]);
        let rgb = rgb.with_shape(&[3, height, width]);
        match filter {
            0 => rgb,
            1 => rgb.with_chunks(&[1, 6, 8]).with_shuffle().with_deflate(4),
            _ => rgb.with_chunks(&[3, 6, 8]).with_lzf(),
        };
        let map = depth();
        let depths = builder.create_dataset("depth").with_f32_data(map.values());
        let depths = depths.with_shape(&[height, width]);
        match filter {
            0 => depths,
            1 => depths.with_chunks(&[6, 8]).with_shuffle().with_deflate(4),
            _ => depths.with_chunks(&[6, 8]).with_lzf(),
        };
        builder.write(&path).unwrap();
        survive(&path, || readable(DatasetKind::Nyu, &root));
    }
    let path = folder.path().join("labelled.mat");
    let mut builder = FileBuilder::new();
    builder.with_userblock(512);
    builder
        .create_dataset("images")
        .with_u8_data(&[9; 2 * 3 * WIDTH * HEIGHT])
        .with_shape(&[2, 3, width, height])
        .with_chunks(&[1, 3, width, height])
        .with_deflate(3);
    builder
        .create_dataset("depths")
        .with_f32_data(&[1.5; 2 * WIDTH * HEIGHT])
        .with_shape(&[2, width, height])
        .with_chunks(&[1, width, height])
        .with_deflate(3);
    builder.write(&path).unwrap();
    survive(&path, || readable(DatasetKind::Nyu, &path));
}

/// A file of 7 kB found by a fuzzer, with a chunk of a declared 4 GiB, which the library allocated before reading. Random
/// damage rarely hits that number.
#[test]
fn a_chunk_that_promises_gigabytes_is_refused() {
    let _turn = TURN
        .lock()
        .unwrap_or_else(std::sync::PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("val/official/00001.h5");
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::copy(found("huge_chunk.h5"), path).unwrap();
    let before = IN_USE.load(Ordering::Relaxed);
    PEAK.store(before, Ordering::Relaxed);
    assert!(!readable(DatasetKind::Nyu, folder.path()));
    assert!(PEAK.load(Ordering::Relaxed) - before < MOST);
}

#[test]
fn maps() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_npz(&at("a.npz"), &[("depth", &depth()), ("sigma", &depth())]).unwrap();
    write_tiff(&at("a.tiff"), &depth()).unwrap();
    write_exr(&at("a.exr"), &depth(), Some(&depth())).unwrap();
    write_pfm(&at("a.pfm"), &depth()).unwrap();
    let numbers = depth()
        .values()
        .iter()
        .map(|v| (1000.0 * v) as u16)
        .collect::<Vec<_>>();
    let body: Vec<u8> = numbers.iter().flat_map(|v| v.to_be_bytes()).collect();
    let head = format!("P5\n# mm\n{WIDTH} {HEIGHT}\n20000\n");
    std::fs::write(at("a.pgm"), [head.as_bytes(), &body].concat()).unwrap();
    let mut builder = FileBuilder::new();
    let group = builder.create_dataset("depth").with_u16_data(&numbers);
    group
        .with_shape(&[HEIGHT as u64, WIDTH as u64])
        .with_fill_value(9_u16);
    builder.write(at("a.h5")).unwrap();
    write_depth_png(&at("a.png"), &depth(), 0.001).unwrap();
    for name in [
        "a.npz", "a.tiff", "a.exr", "a.pfm", "a.pgm", "a.h5", "a.png",
    ] {
        let path = at(name);
        survive(&path, || {
            Sparse::read(&path, None, None, (WIDTH, HEIGHT)).is_ok()
        });
    }
    for name in ["a.webp", "b.tiff"] {
        let path = at(name);
        rgb().save(&path).unwrap();
        survive(&path, || read_rgb(&path).is_ok());
    }
}

#[test]
fn laser_scans() {
    let folder = tempfile::tempdir().unwrap();
    let returns: Vec<scans::Return> = (0..60)
        .map(|i| {
            let at = i as f32;
            (at % 9.0, at / 9.0, 3.0 + at, i as i16 % 4)
        })
        .collect();
    scans::write_scan(folder.path(), "a", &rgb(), &returns);
    let path = folder.path().join("a_points.npz");
    survive(&path, || readable(DatasetKind::Scans, folder.path()));
}

/// A few bytes that decompress to gigabytes.
#[test]
fn archives_that_swell_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bomb.npz");
    let empty = DepthMap::empty(WIDTH, HEIGHT);
    write_npz(&path, &[("depth", &empty)]).unwrap();
    let mut bytes = std::fs::read(&path).unwrap();
    let size = (128 + 4 * WIDTH * HEIGHT) as u32;
    let mut places = 0;
    for i in 0..bytes.len() - 4 {
        if bytes[i..i + 4] == size.to_le_bytes() {
            bytes[i..i + 4].copy_from_slice(&0x7fff_ffff_u32.to_le_bytes());
            places += 1;
        }
    }
    assert!(places > 0, "the size of the array is in the archive");
    std::fs::write(&path, bytes).unwrap();
    refuse(&path, "declares 2147483647 bytes");
}

/// Path of a file found by a fuzzer.
fn found(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    folder.join("tests/damaged").join(name)
}

/// Checks that a file is refused with these words and without excessive memory use.
fn refuse(path: &Path, words: &str) {
    let _turn = TURN
        .lock()
        .unwrap_or_else(std::sync::PoisonError::into_inner);
    let camera = Camera::pinhole([50.0; 2], [12.0, 9.0]);
    let before = IN_USE.load(Ordering::Relaxed);
    PEAK.store(before, Ordering::Relaxed);
    let outcome = Sparse::read(path, None, Some(&camera), (WIDTH, HEIGHT));
    let error = outcome.unwrap_err().to_string();
    assert!(error.contains(words), "{error}");
    assert!(PEAK.load(Ordering::Relaxed) - before < MOST);
}

#[test]
fn clouds() {
    let folder = tempfile::tempdir().unwrap();
    let camera = Camera::pinhole([50.0; 2], [12.0, 9.0]);
    let read = |path: &Path| Sparse::read(path, None, Some(&camera), (WIDTH, HEIGHT)).is_ok();
    let place = |i: u32| [f64::from(i) * 0.01 - 0.5, f64::from(i) * 0.005 - 0.3, 3.0];
    let mut sound = Vec::new();

    let points: Vec<ColoredPoint> = (0..90)
        .map(|i| ColoredPoint {
            position: place(i),
            color: [1, 2, 3],
            sigma: Some(0.5),
        })
        .collect();
    let path = folder.path().join("binary.ply");
    write_ply(&path, &points).unwrap();
    sound.push(path);
    let line = |i| {
        let [x, y, z] = place(i);
        format!("{x} {y} {z} 3 1 2 3\n")
    };
    let lines: Vec<String> = (0..90).map(line).collect();
    let lines = lines.concat();
    let path = folder.path().join("text.ply");
    let head = "ply\nformat ascii 1.0\ncomment none\nelement vertex 90\nproperty float x\n\
        property float y\nproperty float z\nproperty list uchar int more\nend_header\n";
    std::fs::write(&path, format!("{head}{lines}")).unwrap();
    sound.push(path);

    for (name, kind) in [
        ("text.pcd", DataKind::Ascii),
        ("binary.pcd", DataKind::Binary),
        ("packed.pcd", DataKind::BinaryCompressed),
    ] {
        let path = folder.path().join(name);
        let field = |name: &str| (name.to_owned(), ValueKind::F32, 1_u64);
        let fields = ["x", "y", "z"].map(field);
        let start = WriterInit {
            width: 90,
            height: 1,
            viewpoint: pcd_rs::ViewPoint::default(),
            data_kind: kind,
            schema: Some(pcd_rs::Schema::from_iter(fields)),
            version: None,
        };
        let mut writer: DynWriter<_> = start.create(&path).unwrap();
        for i in 0..90 {
            let fields = place(i).map(|v| Field::F32(vec![v as f32]));
            writer.push(&DynRecord(fields.to_vec())).unwrap();
        }
        writer.finish().unwrap();
        sound.push(path);
    }

    for (name, format) in [("scan.las", 0), ("scan.laz", 0), ("layers.laz", 7)] {
        let path = folder.path().join(name);
        let mut builder = las::Builder::from((1, 4));
        builder.point_format = las::point::Format::new(format).unwrap();
        builder.evlrs.push(las::Vlr {
            user_id: "nobody".to_owned(),
            data: vec![7; 100],
            ..las::Vlr::default()
        });
        let header = builder.into_header().unwrap();
        let mut writer = las::Writer::from_path(&path, header).unwrap();
        for i in 0..90 {
            let [x, y, z] = place(i);
            let point = las::Point {
                x,
                y,
                z,
                gps_time: (format > 0).then_some(i as f64),
                color: (format > 0).then(|| las::Color::new(7, 8, i as u16)),
                ..las::Point::default()
            };
            writer.write_point(point).unwrap();
        }
        writer.close().unwrap();
        sound.push(path);
    }
    for path in &sound {
        survive(path, || read(path));
    }
}

#[test]
fn clouds_that_promise_too_much_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cloud.ply");
    for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
        for properties in ["property float x\nproperty float y\nproperty float z\n", ""] {
            let head = format!(
                "ply\nformat {format} 1.0\nelement vertex 1000000000000\n{properties}end_header\n"
            );
            std::fs::write(&path, head + "1 2 3\n").unwrap();
            refuse(&path, "declares 1000000000000 elements `vertex`");
        }
    }
    let path = folder.path().join("cloud.pcd");
    for data in ["ascii", "binary"] {
        let head = format!(
            "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1000000000000\n\
             HEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 1000000000000\nDATA {data}\n"
        );
        std::fs::write(&path, head + "1 2 3\n").unwrap();
        refuse(&path, "declares 12000000000000 bytes");
    }
    refuse(
        &found("no_chunks.laz"),
        "declares 12 points, its chunks hold 0",
    );
}

#[test]
fn points() {
    let folder = tempfile::tempdir().unwrap();
    let read = |path: &Path| Sparse::read(path, None, None, (WIDTH, HEIGHT)).is_ok();
    let path = folder.path().join("points.csv");
    let line = |i: usize| format!("{},{},{},0.1\n", i % WIDTH, i / WIDTH, 1 + i);
    let lines: String = (0..200).map(line).collect();
    std::fs::write(&path, format!("u,v,depth,sigma\n{lines}")).unwrap();
    survive(&path, || read(&path));

    let model = folder.path();
    let numbers =
        |values: &[f64]| -> Vec<u8> { values.iter().flat_map(|v| v.to_le_bytes()).collect() };
    let (one, none) = (1_u64.to_le_bytes(), [0; 4]);
    let size = [WIDTH as u64, HEIGHT as u64].map(u64::to_le_bytes).concat();
    let pinhole = [1_u32, 0].map(u32::to_le_bytes).concat();
    let camera = [&one[..], &pinhole, &size, &numbers(&[50.0, 12.0, 9.0])].concat();
    let pose = numbers(&[1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let seen = [&one[..], &numbers(&[3.0, 4.0]), &one].concat();
    let id = 1_u32.to_le_bytes();
    let image = [&one[..], &none, &pose, &id, b"a.png\0", &seen].concat();
    let place = numbers(&[1.0, 1.0, 5.0]);
    let track = [&one[..], &none, &none].concat();
    let landmark = [&one[..], &one, &place, &[1, 2, 3], &numbers(&[0.5]), &track].concat();
    // One camera with id 1, and its image in a frame.
    let words = |words: &[u32]| {
        words
            .iter()
            .flat_map(|w| w.to_le_bytes())
            .collect::<Vec<_>>()
    };
    let rig = [&one[..], &words(&[1, 1, 0, 1])].concat();
    let frame = [&one[..], &words(&[1, 1]), &pose, &words(&[1, 0, 1, 0, 0])].concat();
    let files = [
        ("cameras.bin", camera),
        ("images.bin", image),
        ("points3D.bin", landmark),
        ("rigs.bin", rig),
        ("frames.bin", frame),
    ];
    for (name, bytes) in &files {
        std::fs::write(model.join(name), bytes).unwrap();
    }
    for (name, bytes) in &files {
        survive(&model.join(name), || {
            let views = Colmap::read(model).map(|model| model.views);
            views.is_ok_and(|views| {
                let mut sparse = views
                    .iter()
                    .map(|view| Sparse::of_view(view, (WIDTH, HEIGHT), None));
                sparse.all(|sparse| sparse.is_ok())
            })
        });
        std::fs::write(model.join(name), bytes).unwrap();
    }
}

#[test]
fn lists() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    std::fs::create_dir_all(root.join("val/indoors/s/t")).unwrap();
    let stem = root.join("val/indoors/s/t/f");
    let beside = |ending: &str| stem.with_file_name(format!("f{ending}"));
    write_rgb(&beside(".png"), &rgb()).unwrap();
    write_npy(&beside("_depth.npy"), &depth()).unwrap();
    write_npy(&beside("_depth_mask.npy"), &depth()).unwrap();
    let path = root.join("diode_meta.json");
    std::fs::write(&path, r#"{"val":{"indoors":{"s":{"t":["f"]}}}}"#).unwrap();
    survive(&path, || readable(DatasetKind::Diode, root));

    let root = &folder.path().join("tum");
    std::fs::create_dir_all(root).unwrap();
    write_rgb(&root.join("a.png"), &rgb()).unwrap();
    write_depth_png(&root.join("b.png"), &depth(), 0.0002).unwrap();
    std::fs::write(root.join("depth.txt"), "1.01 b.png\n").unwrap();
    let path = root.join("rgb.txt");
    std::fs::write(&path, "# time file\n1.00 a.png\n").unwrap();
    survive(&path, || readable(DatasetKind::Tum, root));

    let path = root.join("report.json");
    let report = EvaluationReport::new(lsdc_eval::report::Heading::default());
    report.write_json(&path).unwrap();
    survive(&path, || EvaluationReport::read_json(&path).is_ok());
}

#[test]
fn systems() {
    let folder = tempfile::tempdir().unwrap();
    for config in [
        r#"{"method":"s2d","encoder":"resnet18","width":2}"#,
        r#"{"method":"lsk","width":1,"refine":false}"#,
    ] {
        let config: SystemConfig = serde_json::from_str(config).unwrap();
        let path = folder
            .path()
            .join(format!("{}.safetensors", config.kind().name()));
        let net = config.init(0, &Device::flex()).unwrap();
        let normalisation = config.normalisation([48, 64]);
        let trained = SystemWeights::of(&net, config, normalisation);
        std::fs::write(&path, trained.to_bytes(Precision::Half).unwrap()).unwrap();
        survive(&path, || Predictor::open(&path, &Device::flex()).is_ok());
    }
}

#[test]
fn encoders() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["encoder.pth", "encoder.safetensors"] {
        let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden");
        let path = folder.path().join(name);
        std::fs::copy(golden.join(name), &path).unwrap();
        survive(&path, || read_encoder(&path).is_ok());
    }
}

#[test]
fn recordings() {
    let folder = tempfile::tempdir().unwrap();
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/recordings");
    for name in ["zstd.mcap", "alone.mcap", "drive.mcap", "bag/bag.db3"] {
        let path = folder.path().join(Path::new(name).file_name().unwrap());
        std::fs::copy(golden.join(name), &path).unwrap();
        survive(&path, || {
            let survey =
                Recording::open(&path).and_then(|mut recording| Survey::of(&mut recording));
            survey.is_ok_and(|survey| survey.defects == Defects::default())
        });
    }
    let mut messages = Vec::new();
    let mut recording = Recording::open(&golden.join("zstd.mcap")).unwrap();
    let visited = recording.visit(&|_| true, &mut |topic, message| {
        let kind = MessageType::ALL
            .iter()
            .position(|kind| kind.name() == topic.kind);
        let kinds = ["/depth/rvl_", "/image/nv", "/image/uyvy"];
        if kinds.iter().any(|kind| topic.name.starts_with(kind)) {
            let name = topic.name.replace('/', "_");
            messages.push((name, kind.unwrap() as u8, message.data.to_vec()));
        }
        Ok(())
    });
    visited.unwrap();
    assert_eq!(messages.len(), 6);
    for (name, kind, data) in messages {
        let path = folder.path().join(name);
        std::fs::write(&path, data).unwrap();
        survive(&path, || message(kind, &std::fs::read(&path).unwrap()));
    }
    let path = folder.path().join("frames.mcap");
    // The second recording has a time for each point.
    for (name, points, count) in [
        ("drive.mcap", "/lidar/points", 4),
        ("turn.mcap", "/velodyne/points", 1),
    ] {
        std::fs::copy(golden.join(name), &path).unwrap();
        let wanted = FrameOptions {
            points: Some(points.to_owned()),
            ..FrameOptions::default()
        };
        survive(&path, || {
            let read = || {
                let mut recording = Recording::open(&path)?;
                let frames = Frames::of(&mut recording, &wanted)?;
                for frame in &frames.found {
                    frames.read(&mut recording, frame)?.decode(&frames)?;
                }
                Ok::<bool, lsdc_files::error::Error>(
                    frames.found.len() == count && frames.remarks.is_empty(),
                )
            };
            read().unwrap_or(false)
        });
    }
}
