#!/usr/bin/env python3
"""Compares the error at points left out, which `lsdc complete` prints, with the true error.

Needs numpy. Takes frames written by `lsdc export -o FRAMES`:

    python3 scripts/left_out.py FRAMES [PROGRAM]
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent


def main(frames: str, program: str = str(ROOT / "target/release/lsdc")) -> None:
    rows = []
    for rgb in sorted((Path(frames) / "rgb").rglob("*.png")):
        name = rgb.relative_to(Path(frames) / "rgb").with_suffix(".npy")
        with tempfile.TemporaryDirectory() as folder:
            command = [program, "complete", rgb, Path(frames) / "sparse" / name, "-o", folder, "--json"]
            fit = json.loads(subprocess.check_output(command, text=True))["fit"]
            depth = np.load(Path(folder) / f"{rgb.stem}_depth.npy")
        truth = np.load(Path(frames) / "gt" / name)
        valid = truth > 0
        error = np.sqrt(np.mean((depth - truth)[valid] ** 2))
        rows.append([fit["residual"], fit["leave_one_out"], error])
    residual, left_out, error = np.array(rows).T
    print(f"{len(rows)} frames: residual {residual.mean():.4f} m, left out {left_out.mean():.4f} m, "
          f"true {error.mean():.4f} m")
    print(f"correlation {np.corrcoef(left_out, error)[0, 1]:.3f}, "
          f"median deviation {100 * np.median(np.abs(left_out / error - 1)):.1f} %")


if __name__ == "__main__":
    main(*sys.argv[1:])
