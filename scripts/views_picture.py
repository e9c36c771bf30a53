#!/usr/bin/env python3
"""Draws assets/views.webp: a frame with its points, its depth alone and with the points of neighbours, and the fused mesh.

    cargo run --release -p lsdc-eval --example views -- --rooms 2 --points 200 --write ROOMS
    cd ROOMS/path-1
    lsdc complete images points --camera camera.json --formats npy -o alone
    lsdc complete images points --camera camera.json --formats npy --uncertainty --views=poses.txt -o together
    lsdc fuse together --poses poses.txt --camera camera.json --images images -o mesh.ply
    python3 scripts/views_picture.py ROOMS/path-1 1001.200000 assets/views.webp

Needs NumPy and Pillow.
"""

import json
import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

GAP = 8
# Colours from near to far.
COLOURS = np.array([[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], float)


def coloured(depth, low, high):
    """Returns depths as colours, linear in inverse depth."""
    share = np.clip((1 / low - 1 / np.maximum(depth, low)) / (1 / low - 1 / high), 0, 1) * (len(COLOURS) - 1)
    index = np.minimum(share.astype(int), len(COLOURS) - 2)
    part = (share - index)[..., None]
    return ((1 - part) * COLOURS[index] + part * COLOURS[index + 1]).astype(np.uint8)


def mesh(path):
    """Reads vertices, colours and triangles of a binary PLY of `lsdc fuse`."""
    data = path.read_bytes()
    head, body = data.split(b"end_header\n", 1)
    kinds = {"float": "<f4", "double": "<f8", "uchar": "u1", "int": "<i4", "uint": "<u4"}
    counts, fields = {}, []
    for line in head.decode().splitlines():
        words = line.split()
        if words[:1] == ["element"]:
            counts[words[1]] = int(words[2])
        elif words[:1] == ["property"] and words[1] != "list":
            fields.append((words[2], kinds[words[1]]))
    vertices = np.frombuffer(body, np.dtype(fields), counts["vertex"])
    faces = np.dtype([("count", "u1"), ("index", "<u4", 3)])
    triangles = np.frombuffer(body, faces, counts["face"], vertices.nbytes)["index"]
    return (
        np.stack([vertices[name] for name in "xyz"], axis=1).astype(float),
        np.stack([vertices[name] for name in ("red", "green", "blue")], axis=1).astype(float),
        triangles,
    )


def rotation(x, y, z, w):
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def rendered(surface, camera, turn, place):
    """Renders a mesh, triangle by triangle, lit from the camera."""
    vertices, colours, triangles = surface
    seen = (vertices - place) @ turn
    width, height = camera["width"], camera["height"]
    picture = np.full((height, width, 3), 255.0)
    nearest = np.full((height, width), np.inf)
    corners = seen[triangles]
    in_front = corners[:, :, 2].min(1) > 0.1
    for corner, triangle in zip(corners[in_front], triangles[in_front]):
        x = corner[:, 0] / corner[:, 2] * camera["fx"] + camera["cx"]
        y = corner[:, 1] / corner[:, 2] * camera["fy"] + camera["cy"]
        left, right = max(int(np.ceil(x.min())), 0), min(int(x.max()), width - 1)
        top, bottom = max(int(np.ceil(y.min())), 0), min(int(y.max()), height - 1)
        area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])
        if left > right or top > bottom or area == 0:
            continue
        normal = np.cross(corner[1] - corner[0], corner[2] - corner[0])
        middle = corner.mean(0)
        light = abs(normal @ middle) / (np.linalg.norm(normal) * np.linalg.norm(middle) + 1e-12)
        across, down = np.meshgrid(np.arange(left, right + 1), np.arange(top, bottom + 1))
        b = ((across - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (down - y[0])) / area
        c = ((x[1] - x[0]) * (down - y[0]) - (across - x[0]) * (y[1] - y[0])) / area
        shares = np.stack([1 - b - c, b, c], axis=-1)
        depth = shares @ corner[:, 2]
        region = nearest[top : bottom + 1, left : right + 1]
        covered = (shares >= -1e-9).all(-1) & (depth < region)
        region[covered] = depth[covered]
        shown = (shares @ colours[triangle]) * (0.45 + 0.55 * light)
        picture[top : bottom + 1, left : right + 1][covered] = shown[covered]
    return np.clip(picture, 0, 255).astype(np.uint8)


def main():
    folder, frame, output = Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3])
    camera = json.loads((folder / "camera.json").read_text())
    image = Image.open(folder / f"images/{frame}.png").convert("RGB")
    points = np.load(folder / f"points/{frame}.npy")
    rows, columns = np.nonzero(points)
    truth = np.load(folder / f"depth/{frame}.npy")
    low, high = np.quantile(truth[truth > 0], [0.01, 0.99])
    shown = image.copy()
    draw = ImageDraw.Draw(shown)
    for u, v in zip(columns.tolist(), rows.tolist()):
        colour = tuple(coloured(points[v, u], low, high).tolist())
        draw.ellipse([u - 2, v - 2, u + 2, v + 2], fill=colour, outline="white")
    depths = [np.load(folder / name / f"{frame}_depth.npy") for name in ("alone", "together")]
    for name, depth in zip(("alone", "together"), depths):
        print(f"{name}: RMSE {np.sqrt(np.mean((depth - truth) ** 2)):.3f} m")
    poses = np.loadtxt(folder / "poses.txt")
    pose = poses[np.argmin(abs(poses[:, 0] - float(frame)))]
    # A view from behind and above the camera, looking slightly down.
    turn = rotation(*pose[4:])
    angle = 0.18
    tilted = turn @ np.array([[1, 0, 0], [0, np.cos(angle), np.sin(angle)], [0, -np.sin(angle), np.cos(angle)]])
    place = pose[1:4] + turn @ np.array([0.0, -0.5, -0.3])
    panels = [np.asarray(shown), *(coloured(depth, low, high) for depth in depths)]
    panels.append(rendered(mesh(folder / "mesh.ply"), camera, tilted, place))
    height, width = panels[0].shape[:2]
    sheet = Image.new("RGB", (2 * width + GAP, 2 * height + GAP), "white")
    for i, panel in enumerate(panels):
        sheet.paste(Image.fromarray(panel), (i % 2 * (width + GAP), i // 2 * (height + GAP)))
    sheet.save(output, quality=85)


main()
