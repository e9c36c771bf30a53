#!/usr/bin/env bash
# Builds a program outside the workspace that depends on lsdc-core by path: checks its dependencies, times a cold build, and
# checks that ten lines complete the room.
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
mkdir "$work/src"
cat >"$work/Cargo.toml" <<TOML
[package]
name = "embedder"
version = "0.1.0"
edition = "2024"

[dependencies]
lsdc-core = { path = "$root/crates/core" }
image = { version = "0.25", default-features = false, features = ["png"] }
TOML
cp "$root/Cargo.lock" "$root/rust-toolchain.toml" "$work"
cat >"$work/src/main.rs" <<'RUST'
use lsdc_core::{Channels, Completer, Image, Observations, Weights};
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let rgb = image::open(std::env::args().nth(1).ok_or("which image?")?)?.into_rgb8();
    let image = Image::new(rgb.width() as usize, rgb.height() as usize, Channels::Rgb, &rgb)?;
    let mut points = Observations::new();
    for (u, v, metres) in [(60.0, 50.5, 2.5), (150.2, 120.0, 2.0), (250.0, 60.0, 3.0), (100.0, 200.0, 1.5)] {
        points.add(u, v, metres);
    }
    let depth = Completer::new(&Weights::builtin())?.scene(&image)?.complete(&points)?.depth()?;
    println!("{}x{}, {:?} m", depth.width(), depth.height(), depth.range());
    Ok(())
}
RUST
cd "$root"
crates=$(cargo tree -p lsdc-core -e normal --prefix none | sed 's/ (\*)$//' | sort -u)
count=$(wc -l <<<"$crates")
echo "crates in the normal tree of lsdc-core: $count"
[ "$count" -le 80 ]
if grep -E '^(burn|clap|wgpu|cubecl|hdf5|image|indicatif)' <<<"$crates"; then
  echo "lsdc-core must not depend on these" >&2
  exit 1
fi
cd "$work"
export CARGO_TARGET_DIR="$work/target"
start=$(date +%s)
cargo build --release -q
echo "cold build with lsdc-core: $(($(date +%s) - start)) s"
cargo run --release -q -- "$root/assets/room/rgb.png" | tee output
grep -q '^304x228, Some((' output
