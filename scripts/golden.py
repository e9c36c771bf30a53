#!/usr/bin/env python3
"""Makes tests/golden: results of other libraries with which lsdc must agree.

Needs numpy, scipy, scikit-learn, Pillow and opencv-python-headless:

    python3 -m venv target/golden
    target/golden/bin/pip install numpy scipy scikit-learn pillow opencv-python-headless
    target/golden/bin/python scripts/golden.py

The script shares no code with lsdc: definitions are implemented again.
"""

import json
from pathlib import Path

import cv2
import numpy as np
import scipy.ndimage
import scipy.sparse
import scipy.sparse.linalg
import scipy.stats
import sklearn.metrics
from PIL import Image
from scipy.interpolate import LinearNDInterpolator, RBFInterpolator

OUT = Path(__file__).resolve().parent.parent / "tests" / "golden"


def plain(values) -> list:
    """Returns numbers as read back from JSON: float32 is exact with nine digits."""
    values = np.asarray(values)
    if values.dtype.kind == "f":
        return [float(f"{v:.9g}") for v in values.ravel()]
    return [int(v) for v in values.ravel()]


def picture(height: int, width: int, rng) -> np.ndarray:
    """Returns a colour image with edges, ramps and noise."""
    y, x = np.mgrid[:height, :width]
    image = np.stack([x * 5 + 20, y * 6 + 10, (x + y) * 3], axis=-1).astype(float)
    image[height // 4 : height // 2, width // 3 : 2 * width // 3] = (230, 40, 90)
    return (image + rng.normal(0, 4, image.shape)).clip(0, 255).round().astype(np.uint8)


def resize() -> dict:
    rng = np.random.default_rng(1)
    height, width = 16, 20
    rgb = picture(height, width, rng)
    depth = rng.uniform(0.5, 9.0, (height, width)).astype(np.float32)
    laws = {
        "pil-bilinear": ("pil", Image.BILINEAR),
        "pil-nearest": ("pil", Image.NEAREST),
        "cv-bilinear": ("cv", cv2.INTER_LINEAR),
        "cv-nearest": ("cv", cv2.INTER_NEAREST),
    }
    cases = []
    for law, (library, flag) in laws.items():
        for h, w in [(8, 10), (7, 11), (13, 19), (23, 31), (32, 40)]:
            if library == "pil":
                colours = np.asarray(Image.fromarray(rgb).resize((w, h), flag))
                depths = np.asarray(Image.fromarray(depth).resize((w, h), flag))
            else:
                colours = cv2.resize(rgb, (w, h), interpolation=flag)
                depths = cv2.resize(depth, (w, h), interpolation=flag)
            case = {"law": law, "height": h, "width": w}
            cases.append(case | {"rgb": plain(colours), "depth": plain(depths)})
    source = {"height": height, "width": width, "rgb": plain(rgb), "depth": plain(depth)}
    return {"source": source, "cases": cases}


def soft_edge_error(p, d, window: int, jump: float) -> float:
    """Chen et al. 2019, with shifted copies of padded arrays."""
    valid = d > 0
    edge = np.zeros_like(valid)
    for axis in (0, 1):
        for shift in (1, -1):
            other = np.roll(d, shift, axis)
            inside = np.ones_like(valid)
            border = 0 if shift == 1 else -1
            inside[(border, slice(None)) if axis == 0 else (slice(None), border)] = False
            low, high = np.minimum(d, other), np.maximum(d, other)
            edge |= inside & valid & (other > 0) & (high > jump * low)
    if not edge.any():
        return None
    reach = window // 2
    padded = np.pad(np.where(valid, d, np.inf), reach, constant_values=np.inf)
    height, width = d.shape
    differences = [
        np.abs(p - padded[i : i + height, j : j + width])
        for i in range(window)
        for j in range(window)
    ]
    return float(np.min(differences, axis=0)[edge].mean())


def metrics() -> dict:
    rng = np.random.default_rng(2)
    cases = []
    for noise, holes, window in [(0.05, 0.0, 3), (0.4, 0.3, 1), (1.5, 0.6, 5), (0.2, 0.1, 7)]:
        height, width = 14, 19
        d = np.where(np.arange(width) < 9, 2.0, 3.5) + rng.uniform(0, 0.3, (height, width))
        d = d.astype(np.float32)
        p = (d + rng.normal(0, noise, d.shape)).clip(0, None).astype(np.float32)
        d[rng.uniform(size=d.shape) < holes] = 0
        valid = d > 0
        truth, raw = d[valid].astype(float), p[valid].astype(float)
        safe = np.maximum(raw, 1e-3)
        inverse = 1000 / truth, 1000 / safe
        ratio = np.maximum(safe / truth, truth / safe)
        expected = {
            "rmse": sklearn.metrics.root_mean_squared_error(truth, raw),
            "mae": sklearn.metrics.mean_absolute_error(truth, raw),
            "irmse": sklearn.metrics.root_mean_squared_error(*inverse),
            "imae": sklearn.metrics.mean_absolute_error(*inverse),
            "rel": sklearn.metrics.mean_absolute_percentage_error(truth, raw),
            "log10": sklearn.metrics.mean_absolute_error(np.log10(truth), np.log10(safe)),
            "rmse_log": sklearn.metrics.root_mean_squared_error(np.log(truth), np.log(safe)),
            "delta_1.02": np.mean(ratio < 1.02),
            "delta_1.05": np.mean(ratio < 1.05),
            "delta_1.10": np.mean(ratio < 1.10),
            "delta1": np.mean(ratio < 1.25),
            "delta2": np.mean(ratio < 1.25**2),
            "delta3": np.mean(ratio < 1.25**3),
            "see": soft_edge_error(p.astype(float), d.astype(float), window, 1.05),
        }
        expected = {name: value if value is None else float(value) for name, value in expected.items()}
        case = {"height": height, "width": width, "window": window, "expected": expected}
        cases.append(case | {"prediction": plain(p), "truth": plain(d)})
    pairs = rng.normal([0.2, 0.25], 0.05, (40, 2))
    interval = scipy.stats.ttest_rel(pairs[:, 1], pairs[:, 0]).confidence_interval(0.95)
    difference = {"low": float(interval.low), "high": float(interval.high)}
    return {"cases": cases, "pairs": [plain(pair) for pair in pairs], "difference": difference}


def grid_edges(height: int, width: int):
    index = np.arange(height * width).reshape(height, width)
    first = np.concatenate([index[:, :-1].ravel(), index[:-1].ravel()])
    second = np.concatenate([index[:, 1:].ravel(), index[1:].ravel()])
    return first, second


def weighted_least_squares(rgb, sparse) -> np.ndarray:
    height, width = sparse.shape
    first, second = grid_edges(height, width)
    colours = rgb.reshape(-1, 3).astype(float)
    square = ((colours[first] - colours[second]) ** 2).sum(axis=1)
    weight = np.maximum(1 / (1 + square / 1.5**2), 5e-4)
    n = height * width
    incidence = scipy.sparse.coo_matrix(
        (np.r_[np.ones(len(first)), -np.ones(len(first))],
         (np.r_[np.arange(len(first)), np.arange(len(first))], np.r_[first, second])),
        shape=(len(first), n),
    ).tocsr()
    data = 100.0 * (sparse.ravel() > 0)
    matrix = incidence.T @ scipy.sparse.diags(weight) @ incidence + scipy.sparse.diags(data)
    return scipy.sparse.linalg.spsolve(matrix.tocsc(), data * sparse.ravel()).reshape(height, width)


def colorisation(rgb, sparse) -> np.ndarray:
    height, width = sparse.shape
    grey = rgb.astype(float) @ [0.299, 0.587, 0.114] / 255
    n = height * width
    matrix = scipy.sparse.lil_matrix((n, n))
    right = np.zeros(n)
    for y in range(height):
        for x in range(width):
            i = y * width + x
            matrix[i, i] = 1
            if sparse[y, x] > 0:
                right[i] = sparse[y, x]
                continue
            around = [
                (v, u)
                for v in range(max(y - 1, 0), min(y + 2, height))
                for u in range(max(x - 1, 0), min(x + 2, width))
                if (v, u) != (y, x)
            ]
            values = np.array([grey[v, u] for v, u in around])
            scale = 0.6 * np.var(np.append(values, grey[y, x]))
            squares = (values - grey[y, x]) ** 2
            scale = max(scale, -squares.min() / np.log(0.01), 2e-6)
            weights = np.exp(-squares / scale)
            weights /= weights.sum()
            for (v, u), weight in zip(around, weights):
                matrix[i, v * width + u] = -weight
    return scipy.sparse.linalg.spsolve(matrix.tocsc(), right).reshape(height, width)


def ip_basic(sparse) -> np.ndarray:
    """Ku et al. 2018, with their order of steps and OpenCV's morphology."""
    diamond = np.array([[abs(i) + abs(j) <= 2 for i in range(-2, 3)] for j in range(-2, 3)], np.uint8)
    full = lambda n: np.ones((n, n), np.uint8)
    depth = np.where(sparse > 0, 100 - sparse, 0).astype(np.float32)
    depth = cv2.dilate(depth, diamond)
    depth = cv2.morphologyEx(depth, cv2.MORPH_CLOSE, full(5))
    for size in (7, 31):
        depth = np.where(depth > 0, depth, cv2.dilate(depth, full(size)))
    depth = cv2.medianBlur(depth, 5)
    blurred = cv2.GaussianBlur(depth, (5, 5), 0)
    return 100 - blurred


def classic() -> dict:
    rng = np.random.default_rng(3)
    height, width, count = 30, 40, 70
    rgb = picture(height, width, rng)
    y, x = np.mgrid[:height, :width]
    truth = np.where(x < 18, 2.0 + 0.02 * y, 3.5 + 0.01 * x) + rng.normal(0, 0.02, (height, width))
    chosen = np.sort(rng.choice(height * width, count, replace=False))
    sparse = np.zeros(height * width, np.float32)
    sparse[chosen] = truth.ravel()[chosen]
    sparse = sparse.reshape(height, width)
    places = np.stack([chosen % width, chosen // width], axis=1)
    depths = sparse.ravel()[chosen].astype(float)
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)

    squares = ((pixels[:, None] - places[None]) ** 2).sum(axis=2)
    order = np.argsort(squares, axis=1, kind="stable")[:, :8]
    near = np.take_along_axis(squares, order, axis=1).astype(float)
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = 1 / near
        shepard = (weights * depths[order]).sum(axis=1) / weights.sum(axis=1)
    on_point = near[:, 0] == 0
    shepard[on_point] = depths[order[on_point, 0]]
    nearest = depths[order[:, 0]]

    linear = LinearNDInterpolator(places, depths)(pixels)
    inverse = 1 / LinearNDInterpolator(places, 1 / depths)(pixels)
    spline = RBFInterpolator(places, depths, kernel="thin_plate_spline", degree=1)(pixels)
    expected = {
        "nearest": nearest,
        "linear": np.where(np.isnan(linear), -1, linear),
        "linear-inverse": np.where(np.isnan(inverse), -1, inverse),
        "idw": shepard,
        "tps": spline,
        "wls": weighted_least_squares(rgb, sparse),
        "levin": colorisation(rgb, sparse),
        "ip-basic": ip_basic(sparse),
    }
    distances = scipy.ndimage.distance_transform_edt(sparse == 0)
    # Corners: a larger image, which has many.
    large = picture(90, 120, rng)
    grey = cv2.cvtColor(large, cv2.COLOR_RGB2GRAY)
    corners = cv2.goodFeaturesToTrack(grey, 40, 1e-9, 0, blockSize=3).reshape(-1, 2)
    return {
        "height": height,
        "width": width,
        "rgb": plain(rgb),
        "sparse": plain(sparse),
        "expected": {name: plain(np.asarray(v, np.float64)) for name, v in expected.items()},
        "distances": plain(distances),
        "corners": {"height": 90, "width": 120, "rgb": plain(large), "strongest": plain(corners.astype(int))},
    }


def main() -> None:
    OUT.mkdir(parents=True, exist_ok=True)
    for make in (resize, metrics, classic):
        path = OUT / f"{make.__name__}.json"
        path.write_text(json.dumps(make(), separators=(",", ":")) + "\n")
        print(path.name, path.stat().st_size, "bytes")


if __name__ == "__main__":
    main()
