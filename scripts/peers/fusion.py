#!/usr/bin/env python3
"""Compares surfaces fused by `lsdc fuse` and by Open3D's ScalableTSDFVolume with the exact geometry they were rendered from.

    python3 -m venv target/peers-fusion && target/peers-fusion/bin/pip install numpy open3d==0.19.0
    cargo build --release
    target/peers-fusion/bin/python scripts/peers/fusion.py

The scene is a closed room of 4 x 3 x 2.5 m with a sphere and a box, seen by a camera that moves on a circle. Depths are exact,
or have noise like completed depth: correlated over about 20 pixels, with a standard deviation from 0.5 to 4 % of the depth that
varies between places. Prints the share of the surface within 1, 2 and 5 cm of the exact geometry (accuracy), the share of the
visible geometry with a surface within these distances (completeness), and the mean distances. All peers use the same voxels.
Open3D truncates at four voxels, the least truncation of lsdc. (The volume of Open3D 0.20.0 stays empty.)
"""

import argparse
import json
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import open3d

ROOT = Path(__file__).resolve().parents[2]
WIDTH, HEIGHT, FOCAL = 320, 240, 260.0
CENTER = ((WIDTH - 1) / 2, (HEIGHT - 1) / 2)
ROOM = np.array([2.0, 1.25, 1.5])  # half lengths; y points down
SPHERE, RADIUS = np.array([0.3, 0.75, 0.2]), 0.5
BOX_LOW, BOX_HIGH = np.array([-1.4, 0.45, -0.6]), np.array([-0.7, 1.25, 0.3])
LIMITS = (0.01, 0.02, 0.05)


def cameras(count):
    """Returns rotations (camera to world) and positions on a circle; two thirds look inwards, the others at the walls."""
    for index in range(count):
        angle = 2 * np.pi * index / count
        position = np.array([1.5 * np.cos(angle), -0.3 + 0.2 * np.sin(3 * angle), 1.1 * np.sin(angle)])
        target = np.array([0.0, 0.6, 0.0]) if index % 3 else 2 * position + [0, 0.2 * np.cos(index), 0]
        forwards = (target - position) / np.linalg.norm(target - position)
        right = np.cross([0, 1, 0], forwards)
        right /= np.linalg.norm(right)
        yield np.stack([right, np.cross(forwards, right), forwards], axis=1), position


def distance(points):
    """Returns distances to the exact surfaces."""
    room = np.min(ROOM - np.abs(points), axis=1)
    sphere = np.linalg.norm(points - SPHERE, axis=1) - RADIUS
    outside = np.maximum(BOX_LOW - points, points - BOX_HIGH)
    box = np.linalg.norm(np.maximum(outside, 0), axis=1) + np.minimum(outside.max(axis=1), 0)
    return np.abs(np.stack([room, sphere, box])).min(axis=0)


def render(rotation, position):
    """Returns the exact depths of a camera, and their points."""
    columns, rows = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    rays = np.stack([(columns - CENTER[0]) / FOCAL, (rows - CENTER[1]) / FOCAL, np.ones_like(columns)], axis=-1)
    along = rays.reshape(-1, 3) @ rotation.T
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.max(np.stack([(-ROOM - position) / along, (ROOM - position) / along]), axis=0).min(axis=1)
        low, high = (BOX_LOW - position) / along, (BOX_HIGH - position) / along
    enter, leave = np.minimum(low, high).max(axis=1), np.maximum(low, high).min(axis=1)
    depth = np.where((enter < leave) & (enter > 0), np.minimum(depth, enter), depth)
    offset = position - SPHERE
    a, b, c = (along**2).sum(axis=1), along @ offset, offset @ offset - RADIUS**2
    root = b * b - a * c
    near = np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)
    depth = np.where(near > 0, np.minimum(depth, near), depth)
    return depth.reshape(HEIGHT, WIDTH), position + along * depth[:, None]


def smooth(random, pixels):
    """Returns a random field of mean 0 and variance 1, correlated over some pixels."""
    spectrum = np.fft.rfft2(random.standard_normal((HEIGHT, WIDTH)))
    u, v = np.fft.rfftfreq(WIDTH)[None, :], np.fft.fftfreq(HEIGHT)[:, None]
    field = np.fft.irfft2(spectrum * np.exp(-2 * (np.pi * pixels) ** 2 * (u**2 + v**2) / 4), s=(HEIGHT, WIDTH))
    return (field - field.mean()) / field.std()


def frames(count, noise, seed):
    random = np.random.default_rng(seed)
    for rotation, position in cameras(count):
        exact, points = render(rotation, position)
        relative = 0.005 * 8 ** (0.5 + 0.5 * np.tanh(smooth(random, 40)))
        deviation = exact * (relative if noise else 0.002)
        depth = exact + (deviation * smooth(random, 20) if noise else 0)
        yield rotation, position, depth.astype(np.float32), deviation.astype(np.float32), points


def by_open3d(data, voxel):
    kind = open3d.pipelines.integration.TSDFVolumeColorType.NoColor
    volume = open3d.pipelines.integration.ScalableTSDFVolume(voxel, 4 * voxel, kind)
    camera = open3d.camera.PinholeCameraIntrinsic(WIDTH, HEIGHT, FOCAL, FOCAL, *CENTER)
    grey = open3d.geometry.Image(np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    for rotation, position, depth, _, _ in data:
        image = open3d.geometry.RGBDImage.create_from_color_and_depth(
            grey, open3d.geometry.Image(depth), depth_scale=1.0, depth_trunc=100.0, convert_rgb_to_intensity=False)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation.T, -rotation.T @ position
        volume.integrate(image, camera, pose)
    return volume.extract_triangle_mesh()


def by_lsdc(program, data, voxel, deviations):
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        (folder / "results").mkdir()
        rows = []
        for index, (rotation, position, depth, deviation, _) in enumerate(data):
            np.save(folder / f"results/{index}_depth.npy", depth)
            if deviations:
                np.save(folder / f"results/{index}_sigma.npy", deviation)
            matrix = np.column_stack([rotation, position])
            rows.append(" ".join(repr(float(v)) for v in matrix.ravel()))
        (folder / "poses.txt").write_text("\n".join(rows))
        camera = f"{FOCAL},{FOCAL},{CENTER[0]},{CENTER[1]}"
        command = [program, "fuse", folder / "results", "--poses", folder / "poses.txt", "--camera", camera,
                   "--voxel", str(voxel), "-o", folder / "scene.ply", "--json"]
        told = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        mesh = open3d.io.read_triangle_mesh(str(folder / "scene.ply"))
        assert (len(mesh.vertices), len(mesh.triangles)) == (told["vertices"], told["triangles"])
        glb = [folder / "scene.glb" if word == folder / "scene.ply" else word for word in command]
        subprocess.run(glb, check=True, capture_output=True)
        again = open3d.io.read_triangle_mesh(str(folder / "scene.glb"))
        # y is up in glTF, and down in the world.
        turned = np.asarray(mesh.vertices) * [1, -1, -1]
        assert np.allclose(again.get_min_bound(), turned.min(axis=0), atol=1e-4), "GLB"
        return mesh


def scores(mesh, visible):
    sampled = np.asarray(mesh.sample_points_uniformly(200_000).points)
    accuracy = distance(sampled)
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(open3d.t.geometry.TriangleMesh.from_legacy(mesh))
    completeness = scene.compute_distance(open3d.core.Tensor(visible.astype(np.float32))).numpy()
    shares = [[100 * (found <= limit).mean() for limit in LIMITS] for found in (accuracy, completeness)]
    return shares, 1000 * accuracy.mean(), 1000 * completeness.mean()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lsdc", default=str(ROOT / "target/release/lsdc"))
    parser.add_argument("--frames", type=int, default=36)
    parser.add_argument("--voxel", type=float, default=0.02)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    open3d.utility.random.seed(args.seed)
    for noise in (False, True):
        data = list(frames(args.frames, noise, args.seed))
        visible = np.concatenate([points[::37] for *_, points in data])
        print(f"{'noisy' if noise else 'exact'} depths, {args.frames} frames, voxels of {100 * args.voxel:g} cm")
        for name, fuse in [
            ("Open3D", lambda: by_open3d(data, args.voxel)),
            ("lsdc", lambda: by_lsdc(args.lsdc, data, args.voxel, True)),
            ("lsdc without deviations", lambda: by_lsdc(args.lsdc, data, args.voxel, False)),
        ]:
            started = time.perf_counter()
            mesh = fuse()
            seconds = time.perf_counter() - started
            (accuracy, completeness), off, missing = scores(mesh, visible)
            print(f"  {name:<24} accuracy {' '.join(f'{v:5.1f}' for v in accuracy)} %, mean {off:5.2f} mm; "
                  f"completeness {' '.join(f'{v:5.1f}' for v in completeness)} %, mean {missing:5.2f} mm; "
                  f"{len(mesh.triangles)} triangles, {seconds:.1f} s with files")


if __name__ == "__main__":
    main()
