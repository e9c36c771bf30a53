#!/usr/bin/env bash
# Packs a release archive: `archive.sh PROGRAM NAME FOLDER [RUNS]` writes FOLDER/NAME.tar.gz, or NAME.zip if the program is
# an .exe. RUNS, the same version for this machine, writes the manual pages [default: PROGRAM]. Names and layout must match
# `[package.metadata.binstall]` in Cargo.toml.
set -euo pipefail
program=$1 name=$2 runs=${4:-$1}
mkdir -p "$3"
archive=$(cd "$3" && pwd)/$name
root=$(cd "$(dirname "$0")/.." && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

mkdir "$work/$name"
cp "$program" "$root"/{README.md,CHANGELOG.md,CITATION.cff,LICENSE-MIT,LICENSE-APACHE,NOTICE} "$work/$name"
"$runs" man -o "$work/$name/man" >/dev/null
cd "$work"
if [[ $program != *.exe ]]; then
  tar -czf "$archive.tar.gz" "$name"
elif command -v 7z >/dev/null; then
  rm -f "$archive.zip"
  7z a "$archive.zip" "$name" >/dev/null
else
  python3 -m zipfile -c "$archive.zip" "$name"
fi
