#!/usr/bin/env python3
"""Counts the instructions of one completion on 64-bit Arm, by kind and instruction set, in QEMU.

    python3 scripts/instructions.py [LEVEL...]      # [default: portable neon]

Prints the table of docs/platforms.md: 10^9 instructions for the room with the default weights on one thread. Instructions of
loading are excluded by running the program without completing the room. Needs the packages installed by `.ci/arm`, gcc, and
qemu-user, whose `qemu-aarch64` supports plugins (the static one does not).
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TARGET = "aarch64-unknown-linux-gnu"
TIMES = (0, 1)


def built() -> Path:
    """Builds the example in the build folder of `.ci/arm`."""
    folder = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")) / "arm"
    linker = {"CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER": "aarch64-linux-gnu-gcc", "CARGO_TARGET_DIR": str(folder)}
    command = ["cargo", "build", "--release", "-q", "--locked", "--target", TARGET, "-p", "lsdc-core", "--example", "repeat"]
    subprocess.run(command, check=True, cwd=ROOT, env=os.environ | linker)
    return folder / TARGET / "release/examples/repeat"


def counted(program: Path, plugin: Path, level: str, times: int) -> dict[str, int]:
    """Counts the instructions of a run by kind."""
    env = os.environ | {"LSDC_SIMD": level}
    if not Path("/lib/ld-linux-aarch64.so.1").exists():
        env["QEMU_LD_PREFIX"] = "/usr/aarch64-linux-gnu"
    command = ["qemu-aarch64", "-plugin", str(plugin), str(program), str(times)]
    text = subprocess.run(command, check=True, env=env, capture_output=True, text=True).stderr
    counts = {kind: int(count) for count, kind in (line.split(" ", 1) for line in text.splitlines())}
    if not counts:
        sys.exit("QEMU's plugin has counted nothing")
    return counts


def main() -> None:
    levels = sys.argv[1:] or ["portable", "neon"]
    program = built()
    columns = []
    with tempfile.TemporaryDirectory() as folder:
        plugin = Path(folder) / "instructions.so"
        source = ROOT / "scripts/instructions.c"
        subprocess.run(["gcc", "-O2", "-Wall", "-Wextra", "-shared", "-fPIC", source, "-o", plugin], check=True)
        for level in levels:
            once, twice = (counted(program, plugin, level, times) for times in TIMES)
            columns.append({kind: twice[kind] - once[kind] for kind in once})
    print(f"| kind | {' | '.join(f'`{level}`' for level in levels)} |")
    print("|---" * (1 + len(levels)) + "|")
    for kind in columns[0]:
        print(f"| {kind} | {' | '.join(f'{column[kind] / 1e9:.3f}' for column in columns)} |")
    print(f"| **all** | {' | '.join(f'**{sum(column.values()) / 1e9:.3f}**' for column in columns)} |")


if __name__ == "__main__":
    main()
