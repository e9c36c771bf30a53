#!/usr/bin/env bash
# Programs and wheels for other systems, built on Linux on x86-64:
#
#     scripts/release.sh [TARGET...]      # [default: all of `targets`; `wheel-TARGET` is the Python package]
#
# writes archives, wheels and SHA256SUMS to target/released (LSDC_OUT=FOLDER: to another folder). Checks the libraries that each
# program loads, and completes the room if this machine can run the program (Arm in QEMU, Windows in Wine). Lists what was
# skipped at the end. The workflow `release` builds the same on machines of each system, and also for macOS.
#
# Needs rustup, Python with venv, and for Windows gcc-mingw-w64-x86-64. zig is the C compiler and linker of the others.
# LSDC_PROFILE=release and LSDC_FEATURES="--no-default-features --features serve,weights" give a smaller, faster trial build.
set -euo pipefail
cd "$(dirname "$0")/.."

targets=(
  x86_64-unknown-linux-musl
  x86_64-unknown-linux-gnu
  aarch64-unknown-linux-gnu
  aarch64-unknown-linux-musl
  x86_64-pc-windows-gnu
  wheel-x86_64-unknown-linux-gnu
  wheel-aarch64-unknown-linux-gnu
)
# The oldest version for which Rust builds. Programs and wheels must not need a newer one.
glibc=2.17

step() { printf '\n== release: %s (%s)\n' "$1" "$(date +%T)"; }
fail() {
  echo "release: $1" >&2
  exit 1
}
left_out=()
without() {
  echo "left out: $1"
  left_out+=("$1")
}

[ "$(uname -sm)" = "Linux x86_64" ] || fail "it needs Linux on x86-64"
if [ $# -gt 0 ]; then
  for target in "$@"; do [[ " ${targets[*]} " == *" $target "* ]] || fail "no target \`$target\`; there are ${targets[*]}"; done
  targets=("$@")
fi
version=$(sed -n '/^\[workspace.package\]/,/^\[/s/^version = "\(.*\)"/\1/p' Cargo.toml)
profile=${LSDC_PROFILE:-dist}
read -ra features <<<"${LSDC_FEATURES:-}"
built=$(realpath -m "${CARGO_TARGET_DIR:-target}")
out=$(realpath -m "${LSDC_OUT:-$built/released}")
mkdir -p "$out"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

step "zig"
# Kept in a fixed place: cargo rebuilds all packages if the path of the linker changes.
tools=$built/release-tools
python3 -m venv "$tools"
export PIP_DISABLE_PIP_VERSION_CHECK=1 PATH=$tools/bin:$PATH
pip install -q -r scripts/release-tools.txt 'maturin>=1.14,<2'

# newest_glibc FILE: the newest version of glibc that the file requires.
newest_glibc() { grep -aoE 'GLIBC_[0-9]+\.[0-9]+' "$1" | sed 's/GLIBC_//' | sort -Vu | tail -n 1; }

# Path of glibc for Arm in QEMU (libc6-arm64-cross). If libc6:arm64 is installed, programs hang with another path.
if [ ! -e /lib/ld-linux-aarch64.so.1 ]; then export QEMU_LD_PREFIX=/usr/aarch64-linux-gnu; fi

# The first target runs here: it writes the manual pages of all archives, and the reference depths.
here=$built/x86_64-unknown-linux-musl/$profile/lsdc
# completes COMMAND...: runs a program on the room, and compares its depths with those of this machine's program.
completes() {
  for folder in here "$triple"; do
    command=("$@")
    if [ "$folder" = here ]; then command=("$here"); fi
    [ -e "$work/$folder" ] || "${command[@]}" complete assets/room/rgb.png assets/room/sparse.npy -o "$work/$folder" </dev/null
  done
  python3 scripts/near.py "$work/$triple/rgb_depth.npy" "$work/here/rgb_depth.npy" 2e-5
}

# with_random_numbers PROGRAM: copies a program for Windows next to a library with one function that Rust's standard library
# needs and Wine 8 (Debian 12) lacks.
with_random_numbers() {
  mkdir -p "$work/wine"
  cp "$1" "$work/wine"
  cat >"$work/wine/random.c" <<'EOF'
#include <stddef.h>
unsigned char __stdcall SystemFunction036(void *, unsigned long);
__declspec(dllexport) int __stdcall ProcessPrng(unsigned char *data, size_t size) {
    return SystemFunction036(data, (unsigned long)size);
}
EOF
  x86_64-w64-mingw32-gcc -shared -O1 "$work/wine/random.c" -o "$work/wine/bcryptprimitives.dll" -ladvapi32
  echo "$work/wine/$(basename "$1")"
}

for target in "${targets[@]}"; do
  step "$target"
  triple=${target#wheel-}
  rustup target add "$triple"
  name=lsdc-$version-$triple

  if [ "$target" != "$triple" ]; then
    (cd python && maturin build --release --locked --zig --target "$triple" --compatibility "manylinux_${glibc/./_}" --out "$out")
    continue
  fi

  build=zigbuild zig_target=$triple program=$built/$triple/$profile/lsdc
  case $triple in
    *-linux-gnu) zig_target=$triple.$glibc ;;
    *-windows-gnu)
      # Debian's compiler, which links its thread library statically.
      command -v x86_64-w64-mingw32-gcc >/dev/null || fail "x86_64-w64-mingw32-gcc is missing: apt-get install gcc-mingw-w64-x86-64"
      build=build program=$program.exe
      ;;
  esac
  cargo "$build" --profile "$profile" -p lsdc --locked --target "$zig_target" "${features[@]}"
  released=$program
  echo "$(stat -c %s "$program") bytes"

  case $triple in
    *-linux-musl)
      if readelf -dl "$program" | grep -E 'NEEDED|INTERP'; then fail "$triple is not static"; fi ;;
    *-linux-gnu)
      newest=$(newest_glibc "$program")
      echo "needs glibc $newest"
      [ "$(printf '%s\n' "$newest" "$glibc" | sort -V | tail -n 1)" = "$glibc" ] || fail "$triple needs more than glibc $glibc" ;;
    *-windows-gnu)
      x86_64-w64-mingw32-objdump -p "$program" | sed -n 's/.*DLL Name: //p' | sort -f | tee "$work/libraries"
      if grep -iE '^lib|gcc|pthread' "$work/libraries"; then fail "$triple needs libraries that Windows does not have"; fi ;;
  esac
  [ -x "$here" ] || fail "$here is missing; build x86_64-unknown-linux-musl first"
  emulator=()
  case $triple in
    aarch64-*) emulator=(qemu-aarch64-static) ;;
    *-windows-*) emulator=(wine) ;;
  esac
  if [ ${#emulator[@]} -gt 0 ] && ! command -v "${emulator[0]}" >/dev/null; then
    without "running $triple, because \`${emulator[0]}\` is missing"
  else
    if [ "${emulator[0]:-}" = wine ] && ! find /usr/lib*/ -path '*wine*' -name bcryptprimitives.dll 2>/dev/null | grep -q .; then
      program=$(with_random_numbers "$program")
    fi
    completes "${emulator[@]}" "$program"
  fi
  scripts/archive.sh "$released" "$name" "$out" "$here"
done

step "checksums"
(cd "$out" && sha256sum lsdc-*.* | tee SHA256SUMS)

without "macOS, whose software development kit is only on machines of Apple"
without "tests of the wheels, which the workflow runs on machines of each system"
without "signatures and attestations, which the workflow makes"
echo
for what in "${left_out[@]}"; do echo "release: left out: $what"; done
echo "release: $out"
