#!/usr/bin/env python3
"""Completion of folders of frames: speed compared with single frames, memory, and the state after kill -9.

Makes 640x480 frames from the room in `assets/`, completes them in one call, measures the memory, and compares the time
per frame with `lsdc bench`, measured before and after. Then starts again, kills the program at random times, checks every
file, and lets a last run finish.

    pip install numpy opencv-python-headless
    python3 scripts/folders.py [PROGRAM] [--frames 1000] [--kills 20] [--seed 0]
"""

import argparse
import json
import os
import random
import subprocess
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
ROOM = ROOT / "assets/room"
WIDTH, HEIGHT, POINTS = 640, 480, 500
# Number of different images among the frames.
VIEWS = 20


def make(folder: Path, frames: int) -> None:
    image = cv2.resize(cv2.imread(str(ROOM / "rgb.png")), (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    depth = cv2.resize(np.load(ROOM / "depth.npy"), (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST)
    noise = np.random.default_rng(0)
    (folder / "frames").mkdir()
    (folder / "points").mkdir()
    for view in range(VIEWS):
        shift = 16 * view
        grain = noise.normal(0, 3, image.shape)
        seen = np.clip(np.roll(image, shift, axis=1) + grain, 0, 255).astype(np.uint8)
        sparse = np.zeros((HEIGHT, WIDTH), np.float32)
        places = noise.choice(WIDTH * HEIGHT, POINTS, replace=False)
        sparse.flat[places] = np.roll(depth, shift, axis=1).flat[places]
        for frame in range(view, frames, VIEWS):
            names = folder / f"frames/{frame:06}.png", folder / f"points/{frame:06}.npy"
            if frame == view:
                cv2.imwrite(str(names[0]), seen)
                np.save(names[1], sparse)
            else:
                os.link(folder / f"frames/{view:06}.png", names[0])
                os.link(folder / f"points/{view:06}.npy", names[1])


def resident(pid: int) -> float:
    """Resident memory in megabytes."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1024 for line in lines if line.startswith("VmRSS")), 0.0)


def single(program: str) -> float:
    """Seconds per frame that is already in memory."""
    size = f"{WIDTH}x{HEIGHT}"
    args = [program, "bench", "--size", size, "--points", str(POINTS), "--runs", "31", "--json"]
    return json.loads(subprocess.check_output(args))["total_ms"] / 1e3


def speed(program: str, folder: Path, frames: int) -> None:
    before = single(program)
    memory = []
    started = time.time()
    args = [program, "complete", folder / "frames", folder / "points", "-o", folder / "out", "--quiet"]
    run = subprocess.Popen(args)
    while run.poll() is None:
        memory.append(resident(run.pid))
        time.sleep(0.2)
    each = (time.time() - started) / frames
    assert run.returncode == 0
    after = single(program)
    at = lambda share: memory[int(share * (len(memory) - 2))]
    print(f"{frames} frames: {each * 1e3:.0f} ms each; alone {before * 1e3:.0f} ms before, {after * 1e3:.0f} ms after")
    print(f"memory: {at(0.1):.0f} MB at a tenth, {at(0.5):.0f} MB at half, {at(1):.0f} MB at the end, {max(memory):.0f} MB at most")


def kills(program: str, folder: Path, count: int) -> None:
    out = folder / "killed"
    args = [program, "complete", folder / "frames", folder / "points", "-o", out, "--quiet"]
    formats = ["--formats", "npy,npz,png,tiff,exr,pfm,color"]
    broken = 0
    for _ in range(count):
        run = subprocess.Popen(args + formats)
        time.sleep(random.uniform(0.2, 4.0))
        run.kill()
        run.wait()
        for path in sorted(out.glob("*")) if out.exists() else []:
            try:
                if path.suffix in (".npy", ".npz"):
                    values = np.load(path)
                    values = values if path.suffix == ".npy" else values["depth"]
                elif path.suffix in (".png", ".tiff", ".pfm"):
                    values = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
                else:
                    continue
                assert values.shape[:2] == (HEIGHT, WIDTH)
            except Exception as error:
                broken += 1
                print(f"broken: {path.name}: {error}")
    made = len(list(out.glob("*_depth.npy")))
    hidden = len(list(out.glob(".*")))
    subprocess.run(args + formats, check=True)
    names = len(list((folder / "frames").iterdir()))
    files = len([path for path in out.iterdir() if not path.name.startswith(".")])
    print(f"{count} kills: {broken} broken files, {made} of {names} frames made, {hidden} temporary files left;")
    print(f"the last run finished: {files} files of {7 * names}")
    assert broken == 0 and files == 7 * names


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", nargs="?", default=str(ROOT / "target/release/lsdc"))
    parser.add_argument("--frames", type=int, default=1000)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    random.seed(args.seed)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "speed").mkdir()
        make(folder / "speed", args.frames)
        speed(args.program, folder / "speed", args.frames)
        (folder / "kills").mkdir()
        make(folder / "kills", 500)
        kills(args.program, folder / "kills", args.kills)


if __name__ == "__main__":
    main()
