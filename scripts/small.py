#!/usr/bin/env python3
"""Checks the requirements of small machines: the size of a minimal program, and the memory of completions.

    python3 scripts/small.py

Builds the example `minimal` of lsdc-core with only the weights `small`, in the profile `minimal` (some minutes); its limit is
8 MB. Completes 640x480 pixels with 500 points by `small`, with this program and with `lsdc complete` if that is built; the
limit of each is 120 MB (`ru_maxrss`). For Linux; does not need NumPy.
"""

import os
import resource
import struct
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
WIDTH, HEIGHT, POINTS = 640, 480, 500
MOST_SIZE, MOST_MEMORY = 8e6, 120e6


def inputs(folder: Path) -> None:
    """Writes boxes of different colours and depths, with some noise, as image.ppm, image.png and points.csv."""
    def box(x: int, y: int) -> int:
        return (x // 80 * 37 + y // 60 * 91) % 200

    noise = iter(range(10**9))
    rows = [bytes(box(x, y) + next(noise) * 7919 % 13 for x in range(WIDTH) for _ in range(3)) for y in range(HEIGHT)]
    (folder / "image.ppm").write_bytes(b"P6 %d %d 255\n" % (WIDTH, HEIGHT) + b"".join(rows))

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", WIDTH, HEIGHT, 8, 2, 0, 0, 0))
    values = chunk(b"IDAT", zlib.compress(b"".join(b"\0" + row for row in rows), 1))
    (folder / "image.png").write_bytes(b"\x89PNG\r\n\x1a\n" + header + values + chunk(b"IEND", b""))
    places = [(i * 7919 % WIDTH, i * 104729 % HEIGHT) for i in range(POINTS)]
    lines = [f"{x},{y},{1 + box(x, y) / 100:.3f}" for x, y in places]
    (folder / "points.csv").write_text("\n".join(lines) + "\n")


def memory(command: list) -> int:
    """Returns the peak memory of a command in bytes, which is the only child of a child process."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        failed = subprocess.run(command, stdout=subprocess.DEVNULL).returncode
        kilobytes = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
        os.write(writing, b"failed" if failed else b"%d" % kilobytes)
        os._exit(0)
    os.waitpid(child, 0)
    text = os.read(reading, 100)
    if text == b"failed":
        sys.exit(f"`{command[0]}` failed")
    return 1024 * int(text)


def main() -> None:
    features = ["--no-default-features", "--features", "weights-small"]
    build = ["cargo", "build", "--profile", "minimal", "-q", "--locked", "-p", "lsdc-core", *features, "--example", "minimal"]
    subprocess.run(build, check=True, cwd=ROOT)
    minimal = TARGET / "minimal/examples/minimal"
    found = [("size of a minimal program", minimal.stat().st_size, MOST_SIZE)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        inputs(folder)
        ppm, png, points, depth = (folder / n for n in ["image.ppm", "image.png", "points.csv", "depth.npy"])
        found.append(("memory of it", memory([minimal, ppm, points, depth]), MOST_MEMORY))
        program = TARGET / "release/lsdc"
        if program.exists():
            command = [program, "-q", "complete", png, points, "--weights", "small", "-o", folder / "out"]
            found.append(("memory of `lsdc complete`", memory(command), MOST_MEMORY))
        else:
            print(f"left out: `lsdc complete`, because {program} is not built")
    for what, value, most in found:
        print(f"{what}: {value / 1e6:.1f} MB of {most / 1e6:.0f}")
    sys.exit(any(value > most for _, value, most in found))


if __name__ == "__main__":
    main()
