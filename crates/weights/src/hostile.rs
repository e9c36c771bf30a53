//! Malicious `PyTorch` checkpoints that declare more data than they have: memory is bounded by the length of the file.

use crate::read_tensors;
use lsdc_core::weights::Tensor;
use lsdc_files::error::Result;
use std::collections::BTreeMap;
use std::io::{Cursor, Write as _};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// A tensor as described in a pickle: name, storage, shape and stride.
type Declared<'a> = (String, &'a str, &'a [u64], &'a [u64]);

fn text(program: &mut Vec<u8>, text: &str) {
    program.push(b'X');
    program.extend((text.len() as u32).to_le_bytes());
    program.extend(text.as_bytes());
}

fn numbers(program: &mut Vec<u8>, numbers: &[u64]) {
    program.push(b'(');
    for number in numbers {
        // LONG1
        program.extend([0x8a, 8]);
        program.extend(number.to_le_bytes());
    }
    program.push(b't');
}

/// `{name: torch._utils._rebuild_tensor_v2(storage, 0, shape, stride), ...}`.
fn pickle(tensors: &[Declared<'_>]) -> Vec<u8> {
    let mut program = vec![0x80, 2, b'}', b'('];
    for (name, storage, shape, stride) in tensors {
        text(&mut program, name);
        program.extend(b"ctorch._utils\n_rebuild_tensor_v2\n((");
        text(&mut program, "storage");
        program.extend(b"ctorch\nFloatStorage\n");
        text(&mut program, storage);
        text(&mut program, "cpu");
        program.extend(b"K\x01tQK\x00");
        numbers(&mut program, shape);
        numbers(&mut program, stride);
        program.extend(b"tR");
    }
    program.extend(b"u.");
    program
}

/// Reads a file with these tensors, and with storages of zeros of these lengths.
fn read(
    tensors: &[Declared<'_>],
    storages: &[(&str, usize)],
    method: CompressionMethod,
) -> Result<BTreeMap<String, Tensor>> {
    let mut file = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default().compression_method(method);
    let mut add = |name: &str, bytes: &[u8]| {
        file.start_file(format!("a/{name}"), options).unwrap();
        file.write_all(bytes).unwrap();
    };
    add("data.pkl", &pickle(tensors));
    for (name, bytes) in storages {
        add(&format!("data/{name}"), &vec![0; *bytes]);
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.pth");
    std::fs::write(&path, file.finish().unwrap().into_inner()).unwrap();
    read_tensors(&path)
}

#[test]
fn axes_of_any_length_beside_one_without_values() {
    for (shape, stride) in [
        ([1 << 40, 0], [5, 1]),
        ([1 << 33, 0], [5, 1]),
        ([0, 1 << 40], [1, 5]),
    ] {
        let tensors = [("a".to_owned(), "0", &shape[..], &stride[..])];
        let found = read(&tensors, &[("0", 16)], CompressionMethod::Stored).unwrap();
        assert!(found["a"].values().is_empty());
    }
    for shape in [[1 << 40, 1], [1 << 40, 1 << 40], [u64::MAX >> 1, 2]] {
        let tensors = [("a".to_owned(), "0", &shape[..], &[5, 1][..])];
        let refused = read(&tensors, &[("0", 16)], CompressionMethod::Stored);
        assert!(refused.is_err(), "{shape:?}");
    }
}

#[test]
fn many_tensors_of_one_storage() {
    const BYTES: usize = 1 << 16;
    let shape = [BYTES as u64 / 4];
    let named = |count: usize| -> Vec<Declared<'_>> {
        let tensor = |i: usize| (format!("t{i}"), "0", &shape[..], &[1][..]);
        (0..count).map(tensor).collect()
    };
    let storages = [("0", BYTES)];
    let shared = read(&named(2), &storages, CompressionMethod::Stored).unwrap();
    assert_eq!(shared.len(), 2);
    let error = read(&named(50), &storages, CompressionMethod::Stored).unwrap_err();
    assert!(
        error.to_string().contains("more values than the file has"),
        "{error}"
    );
}

#[test]
fn storages_that_unpack_to_more_than_the_file() {
    const BYTES: usize = 1 << 22;
    let tensors = [("a".to_owned(), "0", &[1][..], &[1][..])];
    let error = read(&tensors, &[("0", BYTES)], CompressionMethod::Deflated).unwrap_err();
    assert!(error.to_string().contains("bytes, more than"), "{error}");
}
