//! Detection by `lsdc complete` of points that are misaligned with the image.

use super::*;
use lsdc_eval::data::ColoredPoint;
use lsdc_recordings::{Header, MessageTimes, MessageType, Writer, write_cloud};

const WARNING: &str = "the points fit the image better moved by";

/// Writes every fifth depth of the room, a different fifth in each of five frames, shifted to the right.
fn moved(at: &Path, frame: usize, columns: usize) {
    let truth = read_npy(&asset("depth.npy"), 1.0).unwrap();
    let (width, height) = (truth.width(), truth.height());
    let depth = |i: usize| match (i % width).checked_sub(columns) {
        Some(x) if i % 5 == frame => truth.values()[i / width * width + x],
        _ => 0.0,
    };
    let values = (0..width * height).map(depth).collect();
    write_npy(at, &DepthMap::new(width, height, values).unwrap()).unwrap();
}

fn warned(folder: &Path, args: &[&str]) -> usize {
    let run = lsdc(folder).arg("complete").args(args).assert().success();
    let text = String::from_utf8(run.get_output().stderr.clone()).unwrap();
    text.matches(WARNING).count()
}

/// A folder with five images of the room, and depths shifted to the right.
fn sequence(columns: usize) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for name in ["images", "points"] {
        std::fs::create_dir(at.join(name)).unwrap();
    }
    for frame in 0..5 {
        std::fs::copy(asset("rgb.png"), at.join(format!("images/{frame}.png"))).unwrap();
        moved(&at.join(format!("points/{frame}.npy")), frame, columns);
    }
    folder
}

#[test]
fn five_frames_with_a_shift_are_warned_of_once() {
    let folder = sequence(12);
    let args = ["images", "points", "-o", "depths"];
    assert_eq!(warned(folder.path(), &args), 1);
    let skipped = ["images", "points", "-o", "others", "--no-alignment"];
    assert_eq!(warned(folder.path(), &skipped), 0);
}

#[test]
fn points_in_their_places_are_not_warned_of() {
    let folder = sequence(0);
    let args = ["images", "points", "-o", "depths"];
    assert_eq!(warned(folder.path(), &args), 0);
}

/// A message in CDR, where numbers are aligned to their size.
struct Cdr(Vec<u8>);

impl Cdr {
    fn new() -> Self {
        // Little-endian.
        Self(vec![0, 1, 0, 0])
    }

    fn stamped(self, stamp: i64, frame: &str) -> Self {
        let seconds = self.u32((stamp / 1_000_000_000) as u32);
        seconds.u32((stamp % 1_000_000_000) as u32).text(frame)
    }

    fn number(mut self, bytes: &[u8]) -> Self {
        let size = (self.0.len() - 4).next_multiple_of(bytes.len());
        self.0.resize(size + 4, 0);
        self.0.extend(bytes);
        self
    }

    fn u32(self, value: u32) -> Self {
        self.number(&value.to_le_bytes())
    }

    fn f64s(self, values: &[f64]) -> Self {
        let numbers = values.iter().map(|value| value.to_le_bytes());
        numbers.fold(self, |cdr, number| cdr.number(&number))
    }

    fn text(self, text: &str) -> Self {
        self.bytes(&[text.as_bytes(), &[0]].concat())
    }

    fn bytes(mut self, bytes: &[u8]) -> Self {
        self = self.u32(bytes.len() as u32);
        self.0.extend(bytes);
        self
    }
}

/// Writes three frames of a stationary camera, and six of a camera moving to the right at 4 m/s, all showing the room. The
/// stamps of images are `late` nanoseconds late.
fn drive(at: &Path, late: i64) {
    const FOCAL: f64 = 260.0;
    let truth = read_npy(&asset("depth.npy"), 1.0).unwrap();
    let (width, height) = (truth.width(), truth.height());
    let middle = [width, height].map(|side| (side as f64 - 1.0) / 2.0);
    let matrix = [FOCAL, 0.0, middle[0], 0.0, FOCAL, middle[1], 0.0, 0.0, 1.0];
    let turned = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let projection = [
        matrix[0], 0.0, matrix[2], 0.0, 0.0, matrix[4], matrix[5], 0.0, 0.0, 0.0, 1.0, 0.0,
    ];
    let png = std::fs::read(asset("rgb.png")).unwrap();
    let mut writer = Writer::create(at).unwrap();
    let mut write = |topic, kind, stamp: i64, message: Cdr| {
        let times = MessageTimes {
            log: stamp as u64,
            publish: stamp as u64,
        };
        writer.write(topic, kind, times, &message.0).unwrap();
    };
    let start = 1_000_000_000_000;
    for tenth in 0..60_i64 {
        let stamp = start + tenth * 100_000_000;
        let place = [0.4 * (tenth - 25).max(0) as f64, 0.0, 0.0];
        let message = Cdr::new().u32(1).stamped(stamp, "odom").text("camera");
        let message = message.f64s(&place).f64s(&[0.0, 0.0, 0.0, 1.0]);
        write("/tf", MessageType::Transforms, stamp, message);
    }
    for frame in 0..9 {
        let taken = start + 1_000_000_000 + frame * 500_000_000;
        let stamp = taken + late;
        let info = Cdr::new()
            .stamped(stamp, "camera")
            .u32(height as u32)
            .u32(width as u32);
        let info = info
            .text("plumb_bob")
            .u32(0)
            .f64s(&matrix)
            .f64s(&turned)
            .f64s(&projection);
        let info = [0; 6].into_iter().fold(info, Cdr::u32).number(&[0]);
        write("/camera/camera_info", MessageType::CameraInfo, stamp, info);
        let image = Cdr::new().stamped(stamp, "camera").text("png").bytes(&png);
        write(
            "/camera/image/compressed",
            MessageType::CompressedImage,
            stamp,
            image,
        );
        // Different points for each frame.
        let pixels = (0..width * height).filter(|i| (i + 37 * frame as usize).is_multiple_of(31));
        let points = pixels.map(|i| {
            let depth = f64::from(truth.values()[i]);
            let away = [i % width, i / width].map(|v| v as f64);
            let [x, y] = [0, 1].map(|axis| (away[axis] - middle[axis]) / FOCAL * depth);
            ColoredPoint {
                position: [x, y, depth],
                color: [0; 3],
                sigma: None,
            }
        });
        let header = Header {
            stamp: taken,
            frame: "camera".to_owned(),
        };
        let cloud = write_cloud(&header, &points.collect::<Vec<_>>());
        write("/lidar/points", MessageType::PointCloud2, taken, Cdr(cloud));
    }
    writer.finish().unwrap();
}

/// Output about stamps for a recording whose images are `late` milliseconds late.
fn said_of_stamps(late: i64) -> Vec<String> {
    let folder = tempfile::tempdir().unwrap();
    drive(&folder.path().join("drive.mcap"), late * 1_000_000);
    let args = [
        "complete",
        "drive.mcap",
        "--tolerance",
        "0.2",
        "-o",
        "depths",
    ];
    let run = lsdc(folder.path()).args(args).assert().success();
    let text = String::from_utf8(run.get_output().stderr.clone()).unwrap();
    let lines = text.lines().filter(|line| line.contains("its stamp"));
    lines.map(str::to_owned).collect()
}

#[test]
fn images_whose_stamps_are_late_are_warned_of_once() {
    let said = said_of_stamps(100);
    assert!(
        said.len() == 1 && said[0].contains("100 ms earlier"),
        "{said:?}"
    );
    let said = said_of_stamps(-100);
    assert!(
        said.len() == 1 && said[0].contains("100 ms later"),
        "{said:?}"
    );
}

#[test]
fn right_stamps_are_not_warned_of() {
    let said = said_of_stamps(0);
    assert!(said.is_empty(), "{said:?}");
}
