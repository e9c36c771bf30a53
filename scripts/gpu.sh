#!/usr/bin/env bash
# Tests and benchmarks on a machine with a GPU that cannot build.
#
#   bash scripts/gpu.sh pack DIR     builds, and copies everything that the other machine needs to DIR
#   bash DIR/gpu.sh run OUT          on the other machine: at most 8 minutes; writes logs and results to OUT
#
# The other machine needs at least the glibc version of this one, and a Vulkan driver. With the encoder of `anything` in the
# folder LSDC_WEIGHTS (`lsdc weights get`), these weights are measured as well.
set -euo pipefail

pack() {
  local target="$1" log
  cd "$(dirname "$0")/.."
  mkdir -p "$target"
  cp "$0" "$target/gpu.sh"
  local cargo=(--release --config .ci/gpu.toml --workspace --features lsdc/wgpu)
  cargo build "${cargo[@]}" --bin lsdc
  cp "${CARGO_TARGET_DIR:-target}/release/lsdc" "$target/lsdc"
  if [[ -n "${LSDC_WEIGHTS:-}" ]]; then
    cp -r "$LSDC_WEIGHTS" "$target/weights"
  fi
  # Both packages have a test `gpu`; Cargo lists the built programs.
  log="$(cargo test "${cargo[@]}" --test gpu --no-run 2>&1 | tee /dev/stderr)"
  sed -nE 's#.*Executable .*\(([^)]*/gpu-[0-9a-f]+)\)#\1#p' <<<"$log" | while read -r program; do
    cp "$program" "$target/test-$(basename "$program")"
  done
}

# Runs a step with a limit in seconds; later steps run even if it fails.
step() {
  local name="$1" limit="$2"
  shift 2
  echo "== $name"
  timeout "$limit" "$@" >"$out/$name.txt" 2>&1 || echo "$name: exit status $?" | tee -a "$out/failed.txt"
  tail -n 12 "$out/$name.txt"
}

run() {
  here="$(cd "$(dirname "$0")" && pwd)"
  out="$1"
  mkdir -p "$out"
  export LSDC_REQUIRE_GPU=1
  step device 20 nvidia-smi
  # Benchmarks first: the tests of training compile many kernels.
  for size in 304x228 640x480; do
    step "bench-$size" 40 "$here/lsdc" bench --device wgpu --size $size --runs 100 --json
    step "cpu-$size" 40 "$here/lsdc" bench --size $size --runs 50 --json
  done
  step bench-small 40 "$here/lsdc" bench --device wgpu --weights small --size 304x228 --runs 100 --json
  step bench-counts 40 "$here/lsdc" bench --device wgpu --size 304x228 --runs 20
  if [[ -d "$here/weights" ]]; then
    export LSDC_WEIGHTS="$here/weights"
    step bench-anything 60 "$here/lsdc" bench --device wgpu --weights anything --size 448x336 --runs 50 --json
    step bench-anything-counts 40 "$here/lsdc" bench --device wgpu --weights anything --size 448x336 --runs 20
    step cpu-anything 60 "$here/lsdc" bench --weights anything --size 448x336 --runs 20 --json
  fi
  # Steps of training, to compare with the model in docs/lab/2026-11-performance.md.
  local sharp=(--set 'preset="sharp"' --set fit.ridge=1e-4)
  for images in 2 8 32; do
    step "training-$images" 40 "$here/lsdc" bench --training --device wgpu --runs 20 "${sharp[@]}" --set train.batch=$images --json
  done
  # Utilisation of the GPU, once per second.
  nvidia-smi dmon -s put -c 20 >"$out/utilisation.txt" 2>&1 &
  step utilisation-bench 40 "$here/lsdc" bench --device wgpu --size 304x228 --runs 500 --json
  wait
  for program in "$here"/test-gpu-*; do
    step "$(basename "$program")" 80 "$program"
  done
}

case "${1:-} ${2:-}" in
"pack "?*) pack "$2" ;;
"run "?*) run "$2" ;;
*) sed -n '2,/^set/p' "$0" | sed '$d; s/^# \{0,1\}//' && exit 2 ;;
esac
