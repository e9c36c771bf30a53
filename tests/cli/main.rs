//! The program as a user runs it.

#![allow(clippy::unwrap_used)]

mod calibration;
mod combinations;
mod complete;
mod eval;
mod experiment;
mod forms;
mod fuse;
mod guide;
mod help;
mod inputs;
mod looking;
#[path = "../loopback/mod.rs"]
mod loopback;
mod many;
mod messages;
mod noise;
mod outputs;
mod recordings;
mod reuse;
#[path = "../scans/mod.rs"]
mod scans;
mod serve;
mod summary;
mod views;
mod weights;
mod workspaces;

use assert_cmd::Command;
use lsdc_eval::data::{DepthMap, read_npy, write_npy};
use std::path::{Path, PathBuf};

fn lsdc(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_lsdc"));
    command
        .current_dir(folder)
        .env_remove("LSDC_DATA")
        .env_remove("LSDC_DEVICE")
        // Otherwise, help texts would be wrapped at this width.
        .env_remove("COLUMNS")
        // No installed weights, and none of the user's.
        .env("LSDC_WEIGHTS", folder.join("nowhere"));
    command
}

fn asset(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("assets/room")
        .join(name)
}

/// A temporary folder with the rendered room.
fn room() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["rgb.png", "sparse.npy"] {
        std::fs::copy(asset(name), folder.path().join(name)).unwrap();
    }
    folder
}

/// Names of the files of a folder, except the records of their inputs.
fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<_> = entries
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .filter(|name| name != ".lsdc")
        .collect();
    names.sort();
    names
}

/// Runs a command that must fail with exit code 2 and one `error:` line with `words`, and write nothing.
fn refused(folder: &Path, args: &[&str], words: &[&str]) {
    let before = names(folder);
    failed(lsdc(folder).args(args), 2, words);
    assert_eq!(names(folder), before, "{args:?} left files behind");
}

/// Runs a command that must fail with this exit code and these words.
fn failed(command: &mut Command, code: i32, words: &[&str]) {
    let output = command.output().unwrap();
    let text = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(code), "{command:?}: {text}");
    assert!(!text.contains("panicked"), "{text}");
    for word in words {
        assert!(text.contains(word), "`{word}` is missing in: {text}");
    }
}

fn json(path: &Path) -> serde_json::Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn text(run: &assert_cmd::assert::Assert) -> String {
    String::from_utf8(run.get_output().stdout.clone()).unwrap()
}

/// Arguments of `eval` on four small rooms.
const ROOMS: [&str; 9] = [
    "eval",
    "--dataset",
    "rooms",
    "--set",
    "data.rooms.width=96",
    "--set",
    "data.rooms.height=72",
    "--limit",
    "4",
];

/// Writes the frames of [`ROOMS`] into the folder `frames`, for [`EVAL_EXPORTED`].
fn export_rooms(at: &Path) {
    let export = ["export", "-o", "frames"];
    let made = lsdc(at).args(export).args(&ROOMS[1..]).assert();
    made.success();
}

const EVAL_EXPORTED: [&str; 7] = [
    "eval",
    "--dataset",
    "marigold",
    "--root",
    "frames",
    "--method",
    "linear",
];

/// Bytes of an npy file whose header declares a terabyte.
fn huge_header() -> Vec<u8> {
    let mut header =
        b"{'descr': '<f4', 'fortran_order': False, 'shape': (500000, 500000), }".to_vec();
    header.resize(117, b' ');
    header.push(b'\n');
    let mut file = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    file.extend(header);
    file
}
