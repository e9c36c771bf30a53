#!/usr/bin/env python3
"""Draws the picture of the README: an image, some of its measured depths, the completed depth and its standard deviation.

    python3 scripts/overview.py IMAGE DEPTH OUT [--unit 0.001] [--points 500] [--program lsdc]

IMAGE and DEPTH are a frame of a depth camera with the same size: a colour image, and a 16-bit PNG with 0 at pixels without
depth. Points are drawn from the measured pixels with a fixed seed; the other measured pixels test the result. Needs numpy
and Pillow. assets/overview.jpg shows a frame of TUM RGB-D, freiburg3_long_office_household.
"""

import argparse
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

GAP, CAPTION = 6, 24
PANEL = (480, 360)
SEED = 0


def turbo(values: np.ndarray) -> np.ndarray:
    """The turbo colour map, with its published polynomial fit (Mikhailov 2019)."""
    powers = np.stack([values**k for k in range(6)], axis=-1)
    red = [0.13572138, 4.61539260, -42.66032258, 132.13108234, -152.94239396, 59.28637943]
    green = [0.09140261, 2.19418839, 4.84296658, -14.18503333, 4.27729857, 2.82956604]
    blue = [0.10667330, 12.64194608, -60.58204836, 110.36276771, -89.90310912, 27.34824973]
    colours = np.stack([powers @ c for c in (red, green, blue)], axis=-1)
    return (colours.clip(0, 1) * 255).round().astype(np.uint8)


def complete(program: str, image: Path, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns depth and standard deviation in metres."""
    with tempfile.TemporaryDirectory() as folder:
        np.save(f"{folder}/points.npy", points)
        command = [program, "complete", image, f"{folder}/points.npy", "-o", f"{folder}/out", "--uncertainty", "--quiet"]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        return tuple(np.load(f"{folder}/out/{image.stem}_{name}.npy") for name in ("depth", "sigma"))


def panel(pixels: np.ndarray) -> Image.Image:
    return Image.fromarray(pixels).resize(PANEL, Image.BICUBIC)


def sheet(rgb: np.ndarray, points: list[tuple[float, float, float]], depth: np.ndarray, sigma: np.ndarray,
          unit: str) -> Image.Image:
    """Four panels: image, points (x, y, depth), depth, standard deviation; pixels whose standard deviation is at least their depth are grey."""
    known = sigma < depth
    low, high = np.quantile(depth[known], [0.01, 0.99])
    most = np.quantile(sigma[known], 0.95)

    def coloured(depth: np.ndarray) -> np.ndarray:
        # Logarithmic, because the background is much farther away.
        return turbo((np.log(np.maximum(depth, low) / low) / np.log(high / low)).clip(0, 1))

    def masked(pixels: np.ndarray) -> Image.Image:
        return panel(np.where(known[..., None], pixels, 235).astype(np.uint8))

    # Draw at four times the size and reduce, for smooth outlines.
    dots = Image.fromarray((rgb * 0.35).astype(np.uint8)).resize((4 * PANEL[0], 4 * PANEL[1]), Image.BICUBIC)
    draw = ImageDraw.Draw(dots)
    for x, y, z in points:
        x, y = (x + 0.5) * dots.width / rgb.shape[1], (y + 0.5) * dots.height / rgb.shape[0]
        draw.ellipse([x - 11, y - 11, x + 11, y + 11], fill=tuple(map(int, coloured(np.float64(z)))))
    panels = [
        ("image", panel(rgb)),
        (f"{len(points)} measured depths", dots.resize(PANEL, Image.LANCZOS)),
        (f"completed depth, {low:.1f} to {high:.1f} {unit}", masked(coloured(depth))),
        (f"standard deviation, 0 to {most:.2f} {unit}", masked(turbo((sigma / most).clip(0, 1)))),
    ]
    width, height = PANEL
    drawn = Image.new("RGB", (2 * width + GAP, 2 * (height + CAPTION) + GAP), "white")
    draw = ImageDraw.Draw(drawn)
    for i, (caption, picture) in enumerate(panels):
        x, y = (i % 2) * (width + GAP), (i // 2) * (height + CAPTION + GAP)
        draw.text((x + 2, y + 2), caption, fill="black", font=ImageFont.load_default(16))
        drawn.paste(picture, (x, y + CAPTION))
    return drawn


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("image", type=Path)
    parser.add_argument("depth", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--unit", type=float, default=0.001, help="metres per unit of DEPTH [default: 0.001]")
    parser.add_argument("--points", type=int, default=500, help="number of points [default: 500]")
    parser.add_argument("--program", default="lsdc")
    given = parser.parse_args()

    rgb = np.asarray(Image.open(given.image).convert("RGB"))
    measured = np.asarray(Image.open(given.depth)).astype(np.float32) * given.unit
    chosen = np.random.default_rng(SEED).choice(np.flatnonzero(measured), given.points, replace=False)
    points = np.zeros_like(measured)
    points.flat[chosen] = measured.flat[chosen]
    depth, sigma = complete(given.program, given.image, points)

    withheld = (measured > 0) & (points == 0)
    error = np.abs(depth - measured)[withheld]
    print(f"{withheld.sum()} withheld depths: RMSE {np.sqrt(np.mean(error**2)):.3f} m, median {np.median(error):.3f} m, "
          f"{100 * np.mean(error <= sigma[withheld]):.0f} % within one standard deviation")

    points = [(x, y, measured[y, x]) for y, x in zip(*np.nonzero(points))]
    sheet(rgb, points, depth, sigma, "m").save(given.out, quality=88, optimize=True)


if __name__ == "__main__":
    main()
