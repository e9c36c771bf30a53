//! Data flows one way: which module may use which.

#![allow(clippy::unwrap_used)]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Every module of `src` and the modules that it may use.
const ALLOWED: &[(&str, &[&str])] = &[
    ("error", &[]),
    ("rng", &[]),
    ("process", &[]),
    ("provenance", &["error"]),
    ("device", &["error"]),
    ("data", &["error", "rng"]),
    ("sample", &["data", "error", "rng"]),
    ("simd", &["rng"]),
    ("conv", &["simd", "rng"]),
    ("norm", &["simd", "rng"]),
    (
        "model",
        &["bilinear", "conv", "norm", "simd", "error", "rng"],
    ),
    ("bilinear", &[]),
    ("nearest", &["rng"]),
    ("field", &["simd", "rng"]),
    ("fit", &["field", "bilinear", "nearest", "error", "rng"]),
    ("classic", &["field", "nearest", "data", "error", "rng"]),
    (
        "predict",
        &[
            "model", "fit", "classic", "sample", "nearest", "data", "simd", "error", "rng",
        ],
    ),
    ("metrics", &["data", "error", "rng"]),
    ("report", &["metrics", "data", "provenance", "error", "rng"]),
    (
        "eval",
        &[
            "report",
            "predict",
            "classic",
            "metrics",
            "sample",
            "data",
            "provenance",
            "error",
            "rng",
        ],
    ),
    (
        "train",
        &[
            "predict", "metrics", "model", "fit", "sample", "data", "error", "rng",
        ],
    ),
    (
        "experiment",
        &[
            "train",
            "eval",
            "report",
            "predict",
            "metrics",
            "model",
            "fit",
            "sample",
            "data",
            "provenance",
            "error",
        ],
    ),
    (
        "config",
        &["eval", "train", "model", "fit", "data", "error"],
    ),
    (
        "cli",
        &[
            "config",
            "device",
            "experiment",
            "eval",
            "train",
            "report",
            "predict",
            "metrics",
            "fit",
            "model",
            "sample",
            "data",
            "simd",
            "provenance",
            "error",
        ],
    ),
];

fn sources(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder)
        .unwrap()
        .map(|e| e.unwrap().path());
    entries
        .flat_map(|path| {
            if path.is_dir() {
                sources(&path)
            } else {
                vec![path]
            }
        })
        .filter(|path| path.extension().is_some_and(|e| e == "rs"))
        .collect()
}

#[test]
fn modules_use_only_what_lies_before_them() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let allowed: BTreeMap<_, _> = ALLOWED.iter().copied().collect();
    for path in sources(&root) {
        let below = path.strip_prefix(&root).unwrap();
        let first = below
            .components()
            .next()
            .unwrap()
            .as_os_str()
            .to_string_lossy();
        let module = first.trim_end_matches(".rs");
        if module == "lib" || module == "main" {
            continue;
        }
        let uses = allowed
            .get(module)
            .unwrap_or_else(|| panic!("`{module}` is not in the table of this test"));
        let text = std::fs::read_to_string(&path).unwrap();
        for found in text.split("crate::").skip(1) {
            let name: String = found
                .chars()
                .take_while(|c| c.is_alphanumeric() || *c == '_')
                .collect();
            assert!(
                name == module || uses.contains(&name.as_str()) || name.is_empty(),
                "{} uses `{name}`, which `{module}` may not",
                below.display()
            );
        }
    }
}

#[test]
fn the_network_never_sees_a_depth() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/model");
    for path in sources(&root) {
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(
            !text.contains("DepthMap"),
            "{} speaks of depths",
            path.display()
        );
    }
}
