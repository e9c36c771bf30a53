//! Whether `lsdc complete` notices that points do not lie where the image shows them.

use super::*;

const WARNING: &str = "the points fit the image better moved by";

/// The depths of the room, moved to the right.
fn moved(at: &Path, columns: usize) {
    let truth = read_npy(&asset("depth.npy"), 1.0).unwrap();
    let (width, height) = (truth.width(), truth.height());
    let depth = |i: usize| match (i % width).checked_sub(columns) {
        Some(x) => truth.values()[i / width * width + x],
        None => 0.0,
    };
    let values = (0..width * height).map(depth).collect();
    write_npy(at, &DepthMap::new(width, height, values).unwrap()).unwrap();
}

fn warned(folder: &Path, args: &[&str]) -> usize {
    let run = lsdc(folder).arg("complete").args(args).assert().success();
    let text = String::from_utf8(run.get_output().stderr.clone()).unwrap();
    text.matches(WARNING).count()
}

/// A folder with five images of the room, and depths moved to the right.
fn sequence(columns: usize) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for name in ["images", "points"] {
        std::fs::create_dir(at.join(name)).unwrap();
    }
    for frame in 0..5 {
        std::fs::copy(asset("rgb.png"), at.join(format!("images/{frame}.png"))).unwrap();
        moved(&at.join(format!("points/{frame}.npy")), columns);
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
