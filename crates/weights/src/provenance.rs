//! The provenance of results: stored beside them as JSON, and compared before they are reused.

use crate::error::{Error, Result};
use lsdc_kernels::simd::Level;
use serde_json::{Value, json};
use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// Returns the dependencies of results besides input, weights and settings: the numerics of the program, and the
/// instruction set in use on this processor.
pub fn numerics() -> Value {
    json!({ "golden": crate::golden(), "simd": Level::here().name() })
}

/// Returns the version and numerics of the program, for records of its results.
pub fn program() -> Value {
    json!({ "version": env!("CARGO_PKG_VERSION"), "numerics": numerics() })
}

/// Returns the time in UTC, as ISO 8601.
pub fn now() -> String {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    date(since.map_or(0, |since| since.as_secs()))
}

/// Formats a time in seconds since 1970.
fn date(seconds: u64) -> String {
    // Years that start in March end with the leap day (Hinnant, `civil_from_days`).
    let days = seconds / 86_400 + 719_468;
    let (era, day) = (days / 146_097, days % 146_097);
    let year = (day - day / 1460 + day / 36_524 - day / 146_096) / 365;
    let of_year = day - (365 * year + year / 4 - year / 100);
    let march = (5 * of_year + 2) / 153;
    let day = of_year - (153 * march + 2) / 5 + 1;
    let month = if march < 10 { march + 3 } else { march - 9 };
    let year = year + era * 400 + u64::from(month <= 2);
    let second = seconds % 86_400;
    let (hour, minute) = (second / 3600, second / 60 % 60);
    let second = second % 60;
    format!("{year}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}Z")
}

/// Returns the differences between two records, one line per value: `fit.robust: null, now "cauchy"`.
pub fn differences(before: &Value, now: &Value) -> Vec<String> {
    let mut found = Vec::new();
    add_differences(&mut found, "", before, now);
    found
}

fn add_differences(found: &mut Vec<String>, name: &str, before: &Value, now: &Value) {
    if let (Value::Object(old), Value::Object(new)) = (before, now) {
        let added = new.keys().filter(|key| !old.contains_key(*key));
        for key in old.keys().chain(added) {
            let name = if name.is_empty() {
                key.clone()
            } else {
                format!("{name}.{key}")
            };
            let value = |of: &serde_json::Map<String, Value>| of.get(key).cloned();
            let (old, new) = (value(old), value(new));
            add_differences(
                found,
                &name,
                &old.unwrap_or_default(),
                &new.unwrap_or_default(),
            );
        }
    } else if before != now {
        found.push(format!("{name}: {before}, now {now}"));
    }
}

/// Returns the hash of the contents of a file.
///
/// # Errors
/// The file cannot be read.
pub fn file_hash(path: &Path) -> Result<String> {
    let mut hash = Hash::new();
    hash.add_file(path)?;
    Ok(hash.text())
}

/// Returns the hash of data in memory, including the boundaries of its parts.
pub fn bytes_hash(parts: &[&[u8]]) -> String {
    let mut hash = Hash::new();
    for part in parts {
        hash.add(&(part.len() as u64).to_le_bytes());
        hash.add(part);
    }
    hash.text()
}

/// Size of a file in bytes, and its modification time in nanoseconds since 1970; `None` if it is missing.
pub type FileStamp = Option<(u64, u64)>;

/// Returns the stamp of a file, without reading it.
pub fn file_stamp(path: &Path) -> FileStamp {
    let found = std::fs::metadata(path).ok()?;
    let written = found.modified().ok()?.duration_since(UNIX_EPOCH).ok()?;
    Some((found.len(), written.as_nanos() as u64))
}

/// Returns the hash of the names and contents of the files in a folder and its subfolders that have one of the extensions.
///
/// # Errors
/// The folder cannot be read.
pub fn folder_hash(path: &Path, endings: &[&str]) -> Result<String> {
    let mut files = Vec::new();
    files_below(path, 0, &mut files)?;
    files.retain(|file| {
        let ending = file.extension().unwrap_or_default();
        endings.iter().any(|e| ending.eq_ignore_ascii_case(e))
    });
    files.sort();
    let mut hash = Hash::new();
    for file in files {
        let name = file.strip_prefix(path).unwrap_or(&file);
        hash.add(name.to_string_lossy().as_bytes());
        hash.add(&[0]);
        hash.add_file(&file)?;
    }
    Ok(hash.text())
}

/// Largest depth of folders, because links may form cycles.
const MAX_DEPTH: usize = 16;

fn files_below(folder: &Path, depth: usize, files: &mut Vec<PathBuf>) -> Result<()> {
    let entries = std::fs::read_dir(folder).map_err(|e| Error::read(folder, e))?;
    for entry in entries {
        let path = entry.map_err(|e| Error::read(folder, e))?.path();
        if !path.is_dir() {
            files.push(path);
        } else if depth < MAX_DEPTH {
            files_below(&path, depth + 1, files)?;
        }
    }
    Ok(())
}

/// FNV-1a, 64 bits, and the number of bytes.
struct Hash {
    state: u64,
    bytes: u64,
}

impl Hash {
    fn new() -> Self {
        Self {
            state: 0xcbf2_9ce4_8422_2325,
            bytes: 0,
        }
    }

    fn add(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.state = (self.state ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
        self.bytes += bytes.len() as u64;
    }

    fn add_file(&mut self, path: &Path) -> Result<()> {
        let mut file = File::open(path).map_err(|e| Error::read(path, e))?;
        let mut buffer = vec![0; 1 << 16];
        loop {
            match file.read(&mut buffer).map_err(|e| Error::read(path, e))? {
                0 => return Ok(()),
                count => self.add(&buffer[..count]),
            }
        }
    }

    fn text(&self) -> String {
        format!("{:016x}, {} bytes", self.state, self.bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_those_of_another_program() {
        // Computed with `date -u -d @SECONDS +%FT%TZ`.
        for (seconds, expected) in [
            (0, "1970-01-01T00:00:00Z"),
            (951_782_399, "2000-02-28T23:59:59Z"),
            (951_782_400, "2000-02-29T00:00:00Z"),
            (1_709_251_199, "2024-02-29T23:59:59Z"),
            (1_735_689_599, "2024-12-31T23:59:59Z"),
            (4_107_542_400, "2100-03-01T00:00:00Z"),
        ] {
            assert_eq!(date(seconds), expected);
        }
    }

    #[test]
    fn differences_are_named() {
        let before = json!({ "fit": { "robust": null, "ridge": 0.5 }, "seed": 3 });
        let now = json!({ "fit": { "robust": "cauchy", "ridge": 0.5 }, "seed": 3, "noise": 1 });
        assert_eq!(differences(&before, &before), Vec::<String>::new());
        assert_eq!(
            differences(&before, &now),
            ["fit.robust: null, now \"cauchy\"", "noise: null, now 1"]
        );
    }

    #[test]
    fn a_changed_byte_a_moved_file_and_a_new_one_are_noticed() {
        let root = tempfile::tempdir().unwrap();
        let at = |name: &str| root.path().join(name);
        std::fs::create_dir(at("below")).unwrap();
        std::fs::write(at("a.npy"), b"foobar").unwrap();
        // FNV-1a, 64 bits, of "foobar", as published with the algorithm.
        assert_eq!(
            file_hash(&at("a.npy")).unwrap(),
            "85944171f73967e8, 6 bytes"
        );
        let whole = || folder_hash(root.path(), &["npy"]).unwrap();
        let mut seen = vec![whole()];
        std::fs::write(at("a.npy"), b"foobaz").unwrap();
        seen.push(whole());
        std::fs::write(at("notes.txt"), b"not looked at").unwrap();
        assert_eq!(seen[1], whole());
        std::fs::rename(at("a.npy"), at("below/a.npy")).unwrap();
        seen.push(whole());
        std::fs::write(at("b.NPY"), b"").unwrap();
        seen.push(whole());
        seen.sort();
        seen.dedup();
        assert_eq!(seen.len(), 4);
    }
}
