#!/usr/bin/env python3
"""Compares a program for any platform with the golden depths: 12 rooms with the weights `default` and `small`.

    cargo run --release --example golden -- FOLDER      # writes the rooms, on any machine
    python3 scripts/golden_program.py FOLDER [COMMAND...]

COMMAND runs the program [default: lsdc], for example `wine lsdc.exe` or `qemu-aarch64-static lsdc`. Prints the largest
differences of depths and standard deviations relative to the range of depths, and fails above 2e-5 (LSDC_TOLERANCE). Does
not need NumPy.
"""

import json
import math
import os
import struct
import subprocess
import sys
import tempfile
import zlib
from array import array
from pathlib import Path

GOLDEN = Path(__file__).resolve().parents[1] / "crates/weights/golden/depths.safetensors"
TOLERANCE = float(os.environ.get("LSDC_TOLERANCE", "2e-5"))
# Columns and rows of the stored results (tests/golden_rooms).
GRID = (24, 18)


def golden() -> dict[str, array]:
    """Returns the values of the golden file by name."""
    data = GOLDEN.read_bytes()
    start = 8 + struct.unpack("<Q", data[:8])[0]
    header = json.loads(data[8:start])
    places = {name: entry["data_offsets"] for name, entry in header.items() if name != "__metadata__"}
    return {name: array("f", data[start + a : start + b]) for name, (a, b) in places.items()}


def png(width: int, height: int, rgb: bytes) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = b"".join(b"\0" + rgb[3 * width * y : 3 * width * (y + 1)] for y in range(height))
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(rows, 1)) + chunk(b"IEND", b"")


def room(rooms: Path, name: str, folder: Path) -> tuple[int, int, float]:
    """Writes image and points of a room for the program; returns its width, height and range of depths."""
    width, height, scale, *numbers = array("d", (rooms / f"{name}.points").read_bytes())
    (folder / f"{name}.png").write_bytes(png(int(width), int(height), (rooms / f"{name}.rgb").read_bytes()))
    points = [numbers[i : i + 4] for i in range(0, len(numbers), 4)]
    has_sigma = any(not math.isnan(point[3]) for point in points)
    lines = ["u,v,depth,sigma" if has_sigma else "u,v,depth"]
    lines += [",".join(repr(number) for number in point[: 3 + has_sigma]) for point in points]
    (folder / f"{name}.csv").write_text("\n".join(lines) + "\n")
    return int(width), int(height), scale


def on_grid(path: Path, width: int, height: int) -> list[float]:
    """Returns the values of an .npy map at the pixels of the golden file."""
    values = array("f", path.read_bytes()[-4 * width * height :])
    columns, rows = ([(2 * i + 1) * size // (2 * of) for i in range(of)] for of, size in zip(GRID, (width, height)))
    return [values[y * width + x] for y in rows for x in columns]


def main() -> None:
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    rooms, command = Path(sys.argv[1]), sys.argv[2:] or ["lsdc"]
    expected, largest, count, failed = golden(), {"depth": 0.0, "sigma": 0.0}, 0, False
    names = sorted(path.stem for path in rooms.glob("*.points"))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sizes = {name: room(rooms, name, folder) for name in names}
        for weights in ("default", "small"):
            for name, (width, height, scale) in sizes.items():
                options = ["--weights", weights, "--uncertainty", "--formats", "npy", "--depth-unit", "m", "-q", "--force", "-o", "out"]
                subprocess.run([*command, "complete", f"{name}.png", f"{name}.csv", *options], cwd=folder, check=True, stdin=subprocess.DEVNULL)
                for what in largest:
                    key = f"{weights}/{name}/{what}"
                    found = on_grid(folder / f"out/{name}_{what}.npy", width, height)
                    apart = max(abs(a - b) for a, b in zip(expected[key], found, strict=True)) / scale
                    largest[what], count = max(largest[what], apart), count + 1
                    if not apart <= TOLERANCE:
                        print(f"{key}: {apart:.1e}")
                        failed = True
    print(f"{count} results: depths {largest['depth']:.1e}, standard deviations {largest['sigma']:.1e} of {TOLERANCE:.0e}")
    sys.exit(failed or not names)


if __name__ == "__main__":
    main()
