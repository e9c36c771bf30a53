//! TUM RGB-D sequences (Sturm et al. 2012): `rgb.txt` and `depth.txt` list times and files, which
//! are matched by time; 16-bit PNG, metres = value / 5000.

use super::folder::{Folder, FrameFiles};
use crate::data::is_depth_image;
use lsdc_files::error::{Error, Result};
use std::path::Path;

/// Largest time difference between an image and its depth map, in seconds: the default of the dataset's `associate.py`.
const MAX_TIME_DIFFERENCE: f64 = 0.02;

/// Opens a sequence, by `associations.txt` if it exists; every split contains all frames.
///
/// # Errors
/// A list that cannot be read, or no pair.
pub(in crate::data) fn tum(root: &Path) -> Result<Folder> {
    let list = root.join("associations.txt");
    let pairs = if list.is_file() {
        associated(root, &list)?
    } else {
        associate(
            &times(&root.join("rgb.txt"))?,
            &times(&root.join("depth.txt"))?,
        )
    };
    let frames: Vec<FrameFiles> = pairs
        .into_iter()
        .map(|(rgb, depth)| FrameFiles {
            id: Path::new(&rgb)
                .file_stem()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned(),
            rgb: root.join(rgb),
            depth: root.join(depth),
            ..FrameFiles::default()
        })
        .collect();
    if frames.is_empty() {
        return Err(Error::config(format!(
            "no image within {MAX_TIME_DIFFERENCE} s of a depth map in `{}`",
            root.display()
        )));
    }
    Ok(Folder::of("TUM RGB-D".into(), "full", 1.0 / 5000.0, frames))
}

/// Reads pairs from a list of times and files, and returns image, then depth. Tools write either order (`associate.py rgb.txt
/// depth.txt`; ICL-NUIM the other); the file formats determine the order.
fn associated(root: &Path, list: &Path) -> Result<Vec<(String, String)>> {
    let rows = lines(list, 4)?;
    let Some([first, second]) = rows.first().map(|row| [&row[1], &row[3]]) else {
        return Ok(Vec::new());
    };
    let is_depth = |name: &str| is_depth_image(&root.join(name));
    let depth_first = match (is_depth(first)?, is_depth(second)?) {
        (false, true) => false,
        (true, false) => true,
        (both, _) => {
            let kind = if both { "depths" } else { "colours" };
            let what = format!("pairs `{first}` with `{second}`, which both hold {kind}");
            return Err(Error::format(list, what)
                .hint("a line is: time, image, time, 16-bit depth map; or depth map first"));
        }
    };
    let pairs = rows.into_iter().map(|row| {
        let (first, second) = (row[1].clone(), row[3].clone());
        if depth_first {
            (second, first)
        } else {
            (first, second)
        }
    });
    Ok(pairs.collect())
}

/// Returns the fields of every line that is not a comment; at least `fewest` each.
fn lines(path: &Path, fewest: usize) -> Result<Vec<Vec<String>>> {
    let text = std::fs::read_to_string(path).map_err(|e| Error::read(path, e))?;
    text.lines()
        .enumerate()
        .map(|(i, line)| (i + 1, line.trim()))
        .filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
        .map(|(number, line)| {
            let fields: Vec<String> = line
                .split([' ', '\t', ','])
                .filter(|field| !field.is_empty())
                .map(str::to_owned)
                .collect();
            if fields.len() < fewest {
                return Err(Error::format(
                    path,
                    format!(
                        "line {number} has {} fields, expected {fewest}",
                        fields.len()
                    ),
                ));
            }
            Ok(fields)
        })
        .collect()
}

fn times(path: &Path) -> Result<Vec<(f64, String)>> {
    lines(path, 2)?
        .into_iter()
        .map(|row| match row[0].parse::<f64>() {
            Ok(time) if time.is_finite() => Ok((time, row[1].clone())),
            _ => Err(Error::format(path, format!("`{}` is no time", row[0]))),
        })
        .collect()
}

/// Pairs files by increasing time difference, each file once, like `associate.py`; sorted by time.
fn associate(rgb: &[(f64, String)], depth: &[(f64, String)]) -> Vec<(String, String)> {
    let mut by_time: Vec<usize> = (0..depth.len()).collect();
    by_time.sort_by(|&a, &b| depth[a].0.total_cmp(&depth[b].0));
    let mut candidates = Vec::new();
    for (i, (time, _)) in rgb.iter().enumerate() {
        let first = by_time.partition_point(|&j| depth[j].0 <= time - MAX_TIME_DIFFERENCE);
        for &j in &by_time[first..] {
            let difference = (depth[j].0 - time).abs();
            if depth[j].0 >= time + MAX_TIME_DIFFERENCE {
                break;
            }
            candidates.push((difference, i, j));
        }
    }
    candidates.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)).then(a.2.cmp(&b.2)));
    let (mut rgb_used, mut depth_used) = (vec![false; rgb.len()], vec![false; depth.len()]);
    let mut pairs = Vec::new();
    for (_, i, j) in candidates {
        if !rgb_used[i] && !depth_used[j] {
            (rgb_used[i], depth_used[j]) = (true, true);
            pairs.push((i, j));
        }
    }
    pairs.sort_by(|a, b| rgb[a.0].0.total_cmp(&rgb[b.0].0));
    pairs
        .into_iter()
        .map(|(i, j)| (rgb[i].1.clone(), depth[j].1.clone()))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_and_depths_are_matched_by_time() {
        let list = |times: &[f64]| -> Vec<(f64, String)> {
            times.iter().map(|t| (*t, format!("{t:.2}"))).collect()
        };
        // 1.00 is matched to 1.005, which is then not available for 1.01; 2.00 has no match.
        let pairs = associate(&list(&[1.0, 1.01, 2.0]), &list(&[1.005, 1.028, 2.5]));
        let expected = [("1.00", "1.00"), ("1.01", "1.03")];
        let expected: Vec<(String, String)> = expected
            .iter()
            .map(|(a, b)| ((*a).into(), (*b).into()))
            .collect();
        assert_eq!(pairs, expected);
    }
}
