#!/usr/bin/env python3
"""Completes a frame with truth from 5 and from 500 points and puts the results side by side: assets/overview.png.

Needs numpy and Pillow, and the encoder of `anything` (`lsdc weights get anything`):

    python3 scripts/overview.py assets/room assets/overview.png [--program lsdc]
"""

import argparse
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

GAP = 6
CAPTION = 22
# The few points are drawn from the sparse ones with this seed.
FEW, SEED = 5, 0
# The cloud is seen from the right and from above, turned about its middle.
YAW, PITCH = np.radians(-28), np.radians(14)
# How far away its middle is, in units of the distance from the camera.
DISTANCE = 1.2
# The focal length in units of the width: that of the camera of NYU Depth v2, which the rooms imitate.
FOCAL = 519 / 640


def turbo(values: np.ndarray) -> np.ndarray:
    """The turbo colour map by its published polynomial fit (Mikhailov 2019)."""
    powers = np.stack([values**k for k in range(6)], axis=-1)
    red = [0.13572138, 4.61539260, -42.66032258, 132.13108234, -152.94239396, 59.28637943]
    green = [0.09140261, 2.19418839, 4.84296658, -14.18503333, 4.27729857, 2.82956604]
    blue = [0.10667330, 12.64194608, -60.58204836, 110.36276771, -89.90310912, 27.34824973]
    colours = np.stack([powers @ c for c in (red, green, blue)], axis=-1)
    return (colours.clip(0, 1) * 255).round().astype(np.uint8)


def complete(program: str, rgb: Path, sparse: np.ndarray, *options: str) -> tuple[np.ndarray, np.ndarray]:
    """Depth and standard deviation, metres."""
    with tempfile.TemporaryDirectory() as folder:
        points = Path(folder) / "points.npy"
        np.save(points, sparse)
        command = [program, "complete", rgb, points, "-o", f"{folder}/out", "--uncertainty", "--quiet", *options]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        return tuple(np.load(f"{folder}/out/{rgb.stem}_{name}.npy") for name in ("depth", "sigma"))


def with_points(rgb: Image.Image, sparse: np.ndarray, colours: np.ndarray, radius: float) -> Image.Image:
    points = Image.fromarray((np.asarray(rgb) * 0.35).astype(np.uint8))
    draw = ImageDraw.Draw(points)
    for y, x in zip(*np.nonzero(sparse)):
        draw.ellipse([x - radius, y - radius, x + radius, y + radius], fill=tuple(map(int, colours[y, x])))
    return points


def cloud(rgb: np.ndarray, depth: np.ndarray) -> Image.Image:
    """The points of a depth map, drawn far ones first, from beside the camera."""
    height, width = depth.shape
    focal = FOCAL * width
    # Four points a pixel, so that few gaps are left where the view comes closer.
    rgb = rgb.repeat(2, 0).repeat(2, 1)
    depth = np.asarray(Image.fromarray(depth).resize((2 * width, 2 * height), Image.BILINEAR))
    v, u = np.mgrid[: 2 * height, : 2 * width] / 2.0
    points = np.stack([(u - width / 2) / focal * depth, (v - height / 2) / focal * depth, depth], -1).reshape(-1, 3)
    middle = np.array([0.0, 0.0, np.median(depth)])
    cos, sin = np.cos(YAW), np.sin(YAW)
    about_y = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
    cos, sin = np.cos(PITCH), np.sin(PITCH)
    about_x = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]])
    seen = (points - middle) @ (about_x @ about_y).T + DISTANCE * middle
    order = np.argsort(-seen[:, 2])
    x = (seen[order, 0] / seen[order, 2] * focal + width / 2).round().astype(int)
    y = (seen[order, 1] / seen[order, 2] * focal + height / 2).round().astype(int)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height) & (seen[order, 2] > 0.1)
    picture = np.full((height, width, 3), 255, np.uint8)
    picture[y[inside], x[inside]] = rgb.reshape(-1, 3)[order][inside]
    return Image.fromarray(picture)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("room", type=Path, help="folder with rgb.png, sparse.npy and depth.npy")
    parser.add_argument("out", type=Path)
    parser.add_argument("--program", default="lsdc")
    given = parser.parse_args()

    path = given.room / "rgb.png"
    rgb = Image.open(path).convert("RGB")
    sparse = np.load(given.room / "sparse.npy")
    truth = np.load(given.room / "depth.npy")
    low, high = truth.min(), truth.max()

    few = np.zeros_like(sparse)
    chosen = np.random.default_rng(SEED).choice(np.flatnonzero(sparse), FEW, replace=False)
    few.flat[chosen] = sparse.flat[chosen]
    knowing, _ = complete(given.program, path, few, "--weights", "anything")
    small, _ = complete(given.program, path, few)
    dense, sigma = complete(given.program, path, sparse)

    def coloured(depth: np.ndarray) -> np.ndarray:
        return turbo(((depth - low) / (high - low)).clip(0, 1))

    def error(depth: np.ndarray) -> str:
        return f"RMSE {np.sqrt(np.mean((depth - truth) ** 2)):.2f} m"

    most = np.quantile(sigma, 0.99)
    picture = Image.fromarray
    # Columns: what there is, few points, many points.
    rows = [
        [
            ("image", rgb),
            (f"{FEW} depths", with_points(rgb, few, coloured(few), 4)),
            (f"{np.count_nonzero(sparse)} depths", with_points(rgb, sparse, coloured(sparse), 1.5)),
        ],
        [
            (f"truth, {low:.1f} to {high:.1f} m", picture(coloured(truth))),
            (f"from {FEW}: {error(small)}", picture(coloured(small))),
            (f"from {np.count_nonzero(sparse)}: {error(dense)}", picture(coloured(dense))),
        ],
        [
            (f"point cloud from {np.count_nonzero(sparse)}, from the side", cloud(np.asarray(rgb), dense)),
            (f"from {FEW}, --weights anything: {error(knowing)}", picture(coloured(knowing))),
            (f"standard deviation from {np.count_nonzero(sparse)}, 0 to {most:.2f} m", picture(turbo((sigma / most).clip(0, 1)))),
        ],
    ]
    width, height = rgb.size
    sheet = Image.new("RGB", (3 * (width + GAP) - GAP, 3 * (height + CAPTION + GAP) - GAP), "white")
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(15)
    for row, line in enumerate(rows):
        for column, (caption, panel) in enumerate(line):
            x, y = column * (width + GAP), row * (height + CAPTION + GAP)
            draw.text((x + 2, y + 2), caption, fill="black", font=font)
            sheet.paste(panel, (x, y + CAPTION))
    # 256 colours: a third of the size.
    sheet.quantize(256, dither=Image.Dither.NONE).save(given.out, optimize=True)


if __name__ == "__main__":
    main()
