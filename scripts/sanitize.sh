#!/usr/bin/env bash
# Runs the tests of the kernels, on every instruction set of this machine, under AddressSanitizer.
# Linux on x86-64; rebuilds all dependencies (about ten minutes on two cores).
set -euo pipefail
cd "$(dirname "$0")/.."

# The stable compiler includes the sanitizer, but only nightly compilers accept the flag without this variable.
export RUSTC_BOOTSTRAP=1
export RUSTFLAGS="-Zsanitizer=address"
export CARGO_PROFILE_RELEASE_STRIP=false
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-target}/sanitize"
target=x86_64-unknown-linux-gnu
cargo test --release --target $target -p lsdc-kernels -p lsdc-core --lib
cargo test --release --target $target -p lsdc-train --lib -- ops model::prepared_tests
