#!/usr/bin/env python3
"""Links the frames on which the error distributions of `small` and `anything` were learned, and lists their scenes.

    python3 scripts/error_frames.py NYU MORE SCANS -o FRAMES
    lsdc calibrate --only-errors --weights WEIGHTS -o OUTPUT --dataset folder --root FRAMES --scenes FRAMES/scenes.csv \\
        --set 'data.folder={ rgb = "{set}/{frame}.jpg", depth = "{set}/{frame}_depth.png" }'

NYU has train/SCENE/FRAME.jpg, MORE has SET/FRAME.jpg, both with FRAME_depth.png in millimetres. SCANS has FRAME.jpg and
FRAME_points.npz of a laser scanner (u, v in pixels, depth in metres). Uses 14 of the training frames of NYU, nine of each set
whose name does not begin with `nyu`, and every fourth of the first 40 scans. Returns beyond 1.1 x the nearest of 7x11 pixels
+ 0.3 m are left out: they may be seen past a nearer surface. Needs numpy, scipy and Pillow.
"""

import argparse
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import minimum_filter

# Sets of photographs from several places, in which three neighbours count as a scene; each other set is one scene.
MIXED = {"rgbdd", "misc"}


def link(source: Path, folder: Path) -> None:
    """Links a file."""
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / source.name
    if not target.is_symlink():
        target.symlink_to(source.resolve())


def link_with_depths(image: Path, folder: Path) -> None:
    """Links an image, and its depths if they exist."""
    link(image, folder)
    depths = image.with_name(f"{image.stem}_depth.png")
    if depths.exists():
        link(depths, folder)


def spread(images: list[Path], count: int) -> list[Path]:
    """Returns at most `count` evenly spaced images."""
    count = min(count, len(images))
    return [images[i * len(images) // count] for i in range(count)]


def depths(scan: Path, size: tuple[int, int]) -> Image.Image:
    """Returns the returns of a scan that are not occluded, as a depth map in millimetres."""
    points, (width, height) = np.load(scan), size
    u, v = (np.round(points[name]).astype(int) for name in "uv")
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    u, v, depth = u[inside], v[inside], points["depth"][inside]
    # The nearest return of a pixel is written last.
    order = np.argsort(-depth)
    found = np.zeros((height, width), np.float32)
    found[v[order], u[order]] = depth[order]
    nearest = minimum_filter(np.where(found > 0, found, np.inf), size=(7, 11))
    found[found > 1.1 * nearest + 0.3] = 0
    return Image.fromarray(np.minimum(found * 1000, 65535).astype(np.uint16))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    for folder in ["nyu", "more", "scans"]:
        parser.add_argument(folder, type=Path, metavar=folder.upper())
    parser.add_argument("-o", "--output", type=Path, required=True)
    args = parser.parse_args()
    scenes = []
    for folder in sorted(args.more.iterdir()):
        if not folder.is_dir() or folder.name.startswith("nyu"):
            continue
        for i, image in enumerate(spread(sorted(folder.glob("*.jpg")), 9)):
            link_with_depths(image, args.output / folder.name)
            part = i // 3 if folder.name in MIXED else ""
            scenes.append(f"{folder.name}/{image.stem},{folder.name}{part}")
    for image in sorted(args.scans.glob("*.jpg"))[:40:4]:
        name = args.scans.name
        # Without a dense map of the scan, which would be overwritten through the link.
        link(image, args.output / name)
        with Image.open(image) as picture:
            returns = depths(image.with_name(f"{image.stem}_points.npz"), picture.size)
        returns.save(args.output / name / f"{image.stem}_depth.png")
        scenes.append(f"{name}/{image.stem},{name}-{image.stem}")
    for image in sorted((args.nyu / "train").glob("*/*.jpg"))[27::57]:
        link_with_depths(image, args.output / "nyu")
        scenes.append(f"nyu/{image.stem},nyu-{image.parent.name}")
    (args.output / "scenes.csv").write_text("\n".join(scenes) + "\n")
    print(f"{len(scenes)} frames")


if __name__ == "__main__":
    main()
