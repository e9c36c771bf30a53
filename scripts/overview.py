#!/usr/bin/env python3
"""Puts image, sparse points, completed depth and truth side by side: assets/overview.png.

Needs numpy and Pillow. Run after
`cargo run --release -- complete assets/room/rgb.png assets/room/sparse.npy -o /tmp/overview`:

    python3 scripts/overview.py assets/room /tmp/overview/rgb_depth.npy assets/overview.png
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

GAP = 6
CAPTION = 18


def turbo(values: np.ndarray) -> np.ndarray:
    """The turbo colour map by its published polynomial fit (Mikhailov 2019)."""
    powers = np.stack([values**k for k in range(6)], axis=-1)
    red = [0.13572138, 4.61539260, -42.66032258, 132.13108234, -152.94239396, 59.28637943]
    green = [0.09140261, 2.19418839, 4.84296658, -14.18503333, 4.27729857, 2.82956604]
    blue = [0.10667330, 12.64194608, -60.58204836, 110.36276771, -89.90310912, 27.34824973]
    colours = np.stack([powers @ c for c in (red, green, blue)], axis=-1)
    return (colours.clip(0, 1) * 255).round().astype(np.uint8)


def main(room: str, depth: str, out: str) -> None:
    rgb = Image.open(Path(room) / "rgb.png")
    sparse = np.load(Path(room) / "sparse.npy")
    truth = np.load(Path(room) / "depth.npy")
    dense = np.load(depth)
    low, high = truth.min(), truth.max()

    def coloured(values: np.ndarray) -> np.ndarray:
        return turbo(((values - low) / (high - low)).clip(0, 1))

    points = Image.fromarray((np.asarray(rgb) * 0.35).astype(np.uint8))
    draw = ImageDraw.Draw(points)
    for y, x in zip(*np.nonzero(sparse)):
        colour = tuple(int(c) for c in coloured(sparse[y : y + 1, x])[0])
        draw.ellipse([x - 1.5, y - 1.5, x + 1.5, y + 1.5], fill=colour)
    error = np.sqrt(np.mean((dense - truth) ** 2))
    panels = [
        ("image", rgb),
        (f"{np.count_nonzero(sparse)} sparse depths", points),
        (f"completed, RMSE {error:.3f} m", Image.fromarray(coloured(dense))),
        (f"truth, {low:.1f} to {high:.1f} m", Image.fromarray(coloured(truth))),
    ]
    width, height = rgb.size
    sheet = Image.new("RGB", (2 * width + GAP, 2 * (height + CAPTION) + GAP), "white")
    for i, (caption, panel) in enumerate(panels):
        x, y = (i % 2) * (width + GAP), (i // 2) * (height + CAPTION + GAP)
        ImageDraw.Draw(sheet).text((x + 2, y + 3), caption, fill="black")
        sheet.paste(panel, (x, y + CAPTION))
    sheet.save(out, optimize=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
