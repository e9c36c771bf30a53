//! Lookup of frames by time, by number or by name.

use super::Poses;
use std::collections::HashMap;

/// Keys of the frames of a file, each with its index among the frames.
#[derive(Clone, Debug)]
pub(super) enum Keys {
    /// Seconds, ascending.
    Times(Vec<f64>),
    /// Row numbers from 0, ascending.
    Rows(Vec<usize>),
    /// Paths without extensions, by their last component.
    Names(HashMap<String, Vec<(String, usize)>>),
}

impl Keys {
    pub(super) fn names(names: impl IntoIterator<Item = String>) -> Self {
        let mut found: HashMap<String, Vec<(String, usize)>> = HashMap::new();
        for (index, name) in names.into_iter().enumerate() {
            let path = without_ending(&normal(&name)).to_owned();
            let stem = last_part(&path).to_owned();
            found.entry(stem).or_default().push((path, index));
        }
        Self::Names(found)
    }

    /// Returns the index of a frame.
    pub(super) fn find(&self, name: &str) -> Option<usize> {
        let name = normal(name);
        match self {
            Self::Times(times) => {
                let time = stems(last_part(&name)).find_map(time_in)?;
                let after = times.partition_point(|t| *t < time);
                let beside = [after.checked_sub(1), Some(after)].into_iter().flatten();
                let off = |index: &usize| (times[*index] - time).abs();
                let nearest = beside
                    .filter(|index| *index < times.len())
                    .min_by(|a, b| off(a).total_cmp(&off(b)))?;
                (off(&nearest) <= Poses::TIME_TOLERANCE).then_some(nearest)
            }
            Self::Rows(rows) => {
                let number = stems(last_part(&name)).find_map(trailing_number)?;
                rows.binary_search(&number).ok()
            }
            Self::Names(names) => stems(&name).find_map(|path| {
                let candidates = names.get(last_part(path))?;
                unique(candidates, |_| true)
                    .or_else(|| unique(candidates, |own| own == path))
                    .or_else(|| unique(candidates, |own| ends_in(own, path) || ends_in(path, own)))
            }),
        }
    }
}

/// Returns the only matching candidate.
fn unique(candidates: &[(String, usize)], fits: impl Fn(&str) -> bool) -> Option<usize> {
    let mut fitting = candidates.iter().filter(|(path, _)| fits(path));
    let first = fitting.next()?;
    fitting.next().is_none().then_some(first.1)
}

/// Whether a path ends with all components of another.
fn ends_in(path: &str, end: &str) -> bool {
    path.strip_suffix(end)
        .is_some_and(|before| before.is_empty() || before.ends_with('/'))
}

/// Returns a path with `/` between its components, and without `.`.
fn normal(path: &str) -> String {
    let path = path.replace('\\', "/");
    let parts: Vec<&str> = path
        .split('/')
        .filter(|part| !matches!(*part, "" | "."))
        .collect();
    parts.join("/")
}

fn last_part(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

/// Iterates over a path and its shortenings by one extension after another: 7-Scenes names the images of
/// `frame-000000.pose.txt` `frame-000000.color.png`.
fn stems(path: &str) -> impl Iterator<Item = &str> {
    std::iter::successors(Some(path), |path| {
        let shorter = without_ending(path);
        (shorter.len() < path.len()).then_some(shorter)
    })
}

/// Returns a path without its last extension. Digits are not an extension, except for the fraction of a time.
fn without_ending(path: &str) -> &str {
    match path.rsplit_once('.') {
        Some((before, ending))
            if !last_part(before).is_empty()
                && !ending.contains('/')
                && !ending.bytes().all(|byte| byte.is_ascii_digit()) =>
        {
            before
        }
        _ => path,
    }
}

/// Parses a name that is a time, in seconds.
fn time_in(text: &str) -> Option<f64> {
    let is_number = text.starts_with(|c: char| c.is_ascii_digit() || matches!(c, '-' | '.'));
    seconds(text.parse().ok().filter(|_| is_number)?)
}

/// Converts a time to seconds. Numbers too large for seconds since 1970 are milliseconds, microseconds or nanoseconds.
pub(super) fn seconds(time: f64) -> Option<f64> {
    /// The year 5138 in seconds, and 1973 in milliseconds; likewise for the smaller units.
    const LARGEST: f64 = 1e11;
    let units = [1.0, 1e3, 1e6, 1e9];
    let unit = units.iter().find(|unit| (time / **unit).abs() < LARGEST)?;
    Some(time / unit)
}

fn trailing_number(stem: &str) -> Option<usize> {
    let digits = stem.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    stem[digits..].parse().ok()
}
