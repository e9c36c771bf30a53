//! Poses in text: trajectories, rows of matrices, and folders with one matrix per file.

use super::keys::{Keys, seconds};
use super::{HINT, PosedFrame, Poses};
use crate::error::{Error, Result};
use crate::pose::{Pose, rotation_matrix};
use std::path::{Path, PathBuf};

/// Number of columns of a TUM trajectory and, below, of KITTI.
const TIMED: usize = 8;
const MATRIX: usize = 12;

/// Why a row has no pose.
pub(super) enum NoPose {
    /// The row is damaged, with the reason.
    Broken(&'static str),
    /// The numbers are not a pose.
    Unsound(String),
}

/// Poses that were read, and the number of rows that could not be.
#[derive(Default)]
pub(super) struct Rows<Key> {
    found: Vec<(Key, Pose)>,
    broken: usize,
    first: Option<String>,
}

impl<Key> Rows<Key> {
    /// Adds the result of one row, file or frame; `place` is its name in messages.
    pub(super) fn add(
        &mut self,
        path: &Path,
        place: &str,
        row: std::result::Result<(Key, Pose), NoPose>,
    ) -> Result<()> {
        match row {
            Ok(row) => self.found.push(row),
            Err(NoPose::Broken(what)) => self.skip(|| format!("{place}, {what}")),
            Err(NoPose::Unsound(what)) => {
                return Err(Error::format(path, format!("{place} {what}")).hint(HINT));
            }
        }
        Ok(())
    }

    fn skip(&mut self, what: impl FnOnce() -> String) {
        self.broken += 1;
        self.first.get_or_insert_with(what);
    }

    fn poses(self, keys: impl FnOnce(Vec<Key>) -> Keys) -> Poses {
        let (found, poses): (Vec<Key>, Vec<Pose>) = self.found.into_iter().unzip();
        let frames = poses
            .into_iter()
            .map(|camera_to_world| PosedFrame {
                pose: camera_to_world.inverse(),
                camera: None,
            })
            .collect();
        Poses::new(keys(found), frames, self.broken, self.first)
    }
}

/// Reads a TUM trajectory or the rows of KITTI, by the number of columns.
pub(super) fn read(path: &Path) -> Result<Poses> {
    let text = std::fs::read_to_string(path).map_err(|e| Error::read(path, e))?;
    let lines = text.lines().enumerate();
    let mut lines = lines
        .map(|(number, line)| (number + 1, line.trim()))
        .filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
        .map(|(number, line)| (number, numbers(line)))
        .peekable();
    // A header has no number.
    lines.next_if(|(_, row)| row.iter().all(Option::is_none));
    let columns = lines.peek().map(|(_, row)| row.len());
    let place = |line: usize| format!("line {line}");
    match columns {
        Some(TIMED) => {
            let mut rows = Rows::default();
            for (line, row) in lines {
                rows.add(path, &place(line), timed(&row))?;
            }
            Ok(timeline(rows))
        }
        Some(MATRIX) => {
            let mut rows = Rows::default();
            for (index, (line, row)) in lines.enumerate() {
                let pose = whole(&row).and_then(|numbers: [f64; MATRIX]| matrix(&numbers));
                rows.add(path, &place(line), pose.map(|pose| (index, pose)))?;
            }
            Ok(rows.poses(Keys::Rows))
        }
        _ => {
            let what = match columns {
                Some(count) => format!(
                    "has {count} numbers in its first row; a TUM trajectory has 8 and KITTI 12"
                ),
                None => "holds no pose".to_owned(),
            };
            Err(Error::format(path, what).hint(HINT))
        }
    }
}

/// Reads every matrix in a folder: `NAME.pose.txt`, or if there are none `NAME.txt`.
pub(super) fn read_folder(path: &Path) -> Result<Poses> {
    let unreadable = |e| Error::read(path, e);
    let mut files: Vec<PathBuf> = Vec::new();
    for entry in std::fs::read_dir(path).map_err(unreadable)? {
        files.push(entry.map_err(unreadable)?.path());
    }
    let name = |file: &Path| {
        let name = file.file_name().unwrap_or_default();
        name.to_string_lossy().into_owned()
    };
    let called = |ending: &str| {
        let mut files: Vec<(String, &PathBuf)> = files
            .iter()
            .filter_map(|file| Some((name(file).strip_suffix(ending)?.to_owned(), file)))
            .collect();
        files.sort();
        files
    };
    let mut matrices = called(".pose.txt");
    if matrices.is_empty() {
        matrices = called(".txt");
    }
    let mut rows = Rows::default();
    for (stem, file) in matrices {
        let text = std::fs::read_to_string(file).map_err(|e| Error::read(file, e))?;
        let pose =
            whole(&numbers(&text)).and_then(|numbers: [f64; 16]| match numbers.split_at(MATRIX) {
                (rows, [0.0, 0.0, 0.0, 1.0]) => matrix(rows),
                _ => Err(NoPose::Broken("does not end in the row 0 0 0 1")),
            });
        let place = format!("`{}`", name(file));
        rows.add(path, &place, pose.map(|pose| (stem, pose)))?;
    }
    Ok(rows.poses(Keys::names))
}

/// Sorts poses by time, dropping repeated times.
fn timeline(mut rows: Rows<f64>) -> Poses {
    rows.found.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    let all = std::mem::take(&mut rows.found);
    for (time, pose) in all {
        match rows.found.last() {
            Some((last, _)) if *last == time => {
                rows.skip(|| format!("at {time} s, has the time of another"));
            }
            _ => rows.found.push((time, pose)),
        }
    }
    rows.poses(Keys::Times)
}

/// Parses the words of a text as numbers, `None` for other words.
fn numbers(text: &str) -> Vec<Option<f64>> {
    text.split(|c: char| c.is_ascii_whitespace() || matches!(c, ',' | ';'))
        .filter(|word| !word.is_empty())
        .map(|word| word.parse().ok())
        .collect()
}

fn whole<const N: usize>(row: &[Option<f64>]) -> std::result::Result<[f64; N], NoPose> {
    let row: &[Option<f64>; N] = row
        .try_into()
        .map_err(|_| NoPose::Broken("has another number of columns"))?;
    let mut numbers = [0.0; N];
    for (number, found) in numbers.iter_mut().zip(row) {
        *number = found.ok_or(NoPose::Broken("holds a word that is no number"))?;
    }
    if numbers.iter().all(|number| number.is_finite()) {
        Ok(numbers)
    } else {
        Err(NoPose::Broken("holds a number that is not finite"))
    }
}

/// Reads a time, and the pose of a translation and a quaternion x, y, z, w.
fn timed(row: &[Option<f64>]) -> std::result::Result<(f64, Pose), NoPose> {
    /// Largest deviation of a length from 1: files round to four digits or more.
    const ROUNDING: f64 = 1e-2;
    let [time, x, y, z, quaternion @ ..] = whole::<TIMED>(row)?;
    let time = seconds(time).ok_or(NoPose::Broken("holds an impossible time"))?;
    let length = quaternion.iter().map(|v| v * v).sum::<f64>().sqrt();
    if length == 0.0 {
        return Err(NoPose::Broken("holds a quaternion of zeros"));
    }
    if (length - 1.0).abs() > ROUNDING {
        return Err(NoPose::Unsound(format!(
            "holds a quaternion of length {length:.3}, expected 1"
        )));
    }
    let pose = Pose {
        rotation: rotation_matrix(quaternion.map(|v| v / length)),
        translation: [x, y, z],
    };
    Ok((time, pose))
}

/// Returns the pose of a matrix of three rows of four numbers, row by row.
pub(super) fn matrix(numbers: &[f64]) -> std::result::Result<Pose, NoPose> {
    if numbers.iter().all(|&number| number == 0.0) {
        return Err(NoPose::Broken("holds a matrix of zeros"));
    }
    let rows: Vec<[f64; 4]> = numbers
        .chunks_exact(4)
        .map(|row| [row[0], row[1], row[2], row[3]])
        .collect();
    Pose::of_rows(&rows).map_err(NoPose::Unsound)
}
