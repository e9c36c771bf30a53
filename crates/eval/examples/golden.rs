//! Prints the largest differences of completions on this platform from the golden ones, without training:
//!
//!     cargo run --release -p lsdc-eval --example golden             compares, and fails beyond the tolerance
//!     cargo run --release -p lsdc-eval --example golden -- FOLDER   also writes the inputs, for crates/wasm/npm/tests/golden.mjs
//!
//! Differences are relative to the range of depths, for the golden depths, standard deviations and leave-one-out errors of the
//! default settings, and all results ([platforms](../../../docs/platforms.md)). `LSDC_SIMD` chooses the instruction set.

#![allow(clippy::print_stdout, clippy::unwrap_used)]

#[path = "../../../tests/golden_rooms/mod.rs"]
mod golden_rooms;

use golden_rooms::{Input, difference, inputs, of_rooms, read};
use lsdc_kernels::simd::Level;
use std::error::Error;
use std::path::Path;

/// Embedded, so that the program can run on another machine.
static GOLDEN: &[u8] = include_bytes!("../../weights/golden/depths.safetensors");

fn main() -> Result<(), Box<dyn Error>> {
    let inputs = inputs();
    if let Some(folder) = std::env::args_os().nth(1) {
        std::fs::create_dir_all(&folder)?;
        inputs
            .iter()
            .try_for_each(|input| write(Path::new(&folder), input))?;
    }
    let golden = read(GOLDEN);
    let results = of_rooms(&inputs, |name| {
        lsdc_weights::open_completer(Some(name.as_ref())).unwrap()
    });
    // Largest difference of the results of the default settings whose names end with `ends`; of all results if it is empty.
    let largest = |ends: &str| {
        let of_default = |name: &str| name.matches('/').count() == 2 && name.ends_with(ends);
        let some = results.iter();
        let some = some.filter(|(name, _)| ends.is_empty() || of_default(name));
        some.fold([0.0_f32; 2], |[share, tolerances], (name, found)| {
            let apart = difference(golden.get(name), found);
            [share.max(apart * found.allowed()), tolerances.max(apart)]
        })
    };
    let shown = ["/depth", "/sigma", "/left out", ""].map(largest);
    println!(
        "{} {}: depths {:.1e}, deviations {:.1e}, left out {:.1e}; of {} results, the largest difference is {:.2} of its tolerance",
        std::env::consts::ARCH,
        Level::here().name(),
        shown[0][0],
        shown[1][0],
        shown[2][0],
        results.len(),
        shown[3][1],
    );
    if shown[3][1] <= 1.0 {
        Ok(())
    } else {
        Err("the results are not the golden ones".into())
    }
}

/// Writes NAME.rgb, and NAME.points: the width and the height of the image, the range of depths, and u, v, depth and
/// standard deviation (NaN if unknown) of each point, as 64-bit floats.
fn write(folder: &Path, input: &Input) -> std::io::Result<()> {
    let rgb = &input.frame.rgb;
    let (low, high) = input.frame.depth.range().unwrap();
    let head = [
        f64::from(rgb.width()),
        f64::from(rgb.height()),
        f64::from(high - low),
    ];
    let rows = input.points.iter().flat_map(|point| {
        let sigma = point.sigma.map_or(f64::NAN, f64::from);
        [point.u, point.v, f64::from(point.depth), sigma]
    });
    let bytes: Vec<u8> = head
        .into_iter()
        .chain(rows)
        .flat_map(f64::to_le_bytes)
        .collect();
    std::fs::write(folder.join(format!("{}.points", input.name)), bytes)?;
    std::fs::write(folder.join(format!("{}.rgb", input.name)), rgb.as_raw())
}
