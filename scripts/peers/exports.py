"""Reads the workspaces of `lsdc complete --export` with their target programs, on a scene of known geometry.

    pip install numpy scipy pillow opencv-python-headless pycolmap plyfile; apt install colmap
    python3 scripts/peers/exports.py target/release/lsdc [--splatting CLONE] [--nerfstudio CLONE] [--work DIR]

Eight pinhole views of two boxes in a room are ray-cast with exact depth. `lsdc` completes them twice: from the landmarks of
a sparse model, and with `--method nearest` from a model with a point at every pixel, which exports exact depth. Then
- pycolmap reads the depth and normal maps, and `colmap stereo_fusion` (and pycolmap's) fuses them. Accuracy is the share of
  fused points within a distance of the surfaces; completeness is the share of the surface, as seen by three views or more,
  within that distance of a fused point;
- the loaders of clones of graphdeco-inria/gaussian-splatting and nerfstudio read their workspaces. They run on NumPy: a few
  lines replace torch, of which they need only arrays.
"""

import argparse
import contextlib
import importlib
import io
import json
import pathlib
import shutil
import struct
import subprocess
import sys
import tempfile
import types

import cv2
import numpy as np
import pycolmap
from PIL import Image
from scipy.spatial import cKDTree

WIDTH, HEIGHT, FOCAL = 480, 360, 400.0
CENTRE = (WIDTH / 2, HEIGHT / 2)  # COLMAP's convention: the centre of the first pixel is 0.5
VIEWS = 8
LANDMARKS = 3000
DISTANCES = (0.01, 0.02, 0.05)


# ---- the scene ----


def faces(low, high, inward):
    """Returns the six rectangles of a box: corner, two edges, normal."""
    low, high = np.array(low, float), np.array(high, float)
    found = []
    for axis in range(3):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        for side, sign in ((low, -1), (high, 1)):
            corner = low.copy()
            corner[axis] = side[axis]
            edges = np.zeros((2, 3))
            edges[0, a] = (high - low)[a]
            edges[1, b] = (high - low)[b]
            normal = np.zeros(3)
            normal[axis] = -sign if inward else sign
            found.append((corner, edges, normal))
    return found


RECTANGLES = (
    faces((-4, -4, 0), (4, 3, 3), inward=True)
    + faces((-0.6, -0.5, 0), (0.5, 0.6, 0.8), inward=False)
    + faces((0.8, 0.2, 0), (1.4, 1.1, 1.3), inward=False)
)


def cast(origin, rays):
    """Returns the distance along each ray to the first surface, and the index of the surface."""
    best, which = np.full(len(rays), np.inf), np.zeros(len(rays), int)
    for index, (corner, edges, normal) in enumerate(RECTANGLES):
        with np.errstate(divide="ignore", invalid="ignore"):
            along = ((corner - origin) @ normal) / (rays @ normal)
        place = origin + along[:, None] * rays - corner
        inside = np.ones(len(rays), bool)
        for edge in edges:
            share = place @ edge / (edge @ edge)
            inside &= (share >= -1e-9) & (share <= 1 + 1e-9)
        closer = inside & (along > 1e-6) & (along < best)
        best[closer], which[closer] = along[closer], index
    return best, which


def distance(points):
    """Returns the distance of points to the nearest surface."""
    best = np.full(len(points), np.inf)
    for corner, edges, normal in RECTANGLES:
        offset = points - corner
        square = (offset @ normal) ** 2
        for edge in edges:
            length = np.linalg.norm(edge)
            along = offset @ edge / length
            square += (along - along.clip(0, length)) ** 2
        best = np.minimum(best, np.sqrt(square))
    return best


def colours(points, which):
    """A texture in space, and a colour for each surface."""
    random = np.random.default_rng(7)
    base = random.uniform(60, 190, (len(RECTANGLES), 3))[which]
    waves = random.normal(0, 9, (24, 3))
    phases = random.uniform(0, 6.3, 24)
    texture = np.sin(points @ waves.T + phases).sum(1) / 24
    return (base + 160 * texture[:, None]).clip(0, 255).astype(np.uint8)


def poses():
    """Returns world-to-camera poses on an arc around the boxes."""
    target = np.array([0.2, 0.1, 0.5])
    for angle in np.radians(np.linspace(-50, 50, VIEWS)):
        centre = np.array([2.6 * np.sin(angle), -2.6 * np.cos(angle), 1.6])
        forward = (target - centre) / np.linalg.norm(target - centre)
        right = np.cross(forward, [0, 0, 1])
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        yield rotation, -rotation @ centre


def pixels():
    u, v = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    return np.stack([u.ravel(), v.ravel()], 1)


def rays_of(at, rotation):
    x = (at - CENTRE) / FOCAL
    return np.concatenate([x, np.ones((len(x), 1))], 1) @ rotation


def project(points, pose):
    rotation, translation = pose
    place = points @ rotation.T + translation
    with np.errstate(divide="ignore", invalid="ignore"):
        return FOCAL * place[:, :2] / place[:, 2:] + CENTRE, place[:, 2]


def sees(pose, points):
    """Returns which points a view sees, and their positions in the image."""
    rotation, translation = pose
    at, depth = project(points, pose)
    inside = (depth > 0) & (at > 1).all(1) & (at < np.array([WIDTH, HEIGHT]) - 1).all(1)
    found, _ = cast(-rotation.T @ translation, rays_of(at, rotation))
    return inside & (np.abs(found - depth) < 1e-6 * depth), at


class Scene:
    def __init__(self):
        self.poses = list(poses())
        self.depths, self.normals, self.images, clouds = [], [], [], []
        normals = np.array([normal for _, _, normal in RECTANGLES])
        for rotation, translation in self.poses:
            centre = -rotation.T @ translation
            rays = rays_of(pixels(), rotation)
            depth, which = cast(centre, rays)
            points = centre + depth[:, None] * rays
            self.depths.append(depth.reshape(HEIGHT, WIDTH))
            self.normals.append((normals[which] @ rotation.T).reshape(HEIGHT, WIDTH, 3))
            self.images.append(colours(points, which).reshape(HEIGHT, WIDTH, 3))
            clouds.append(points)
        # The surface seen by three views or more, with about a point per 2 cm.
        cloud = np.concatenate(clouds)[:: 5]
        _, first = np.unique(np.floor(cloud / 0.02).astype(int), axis=0, return_index=True)
        cloud = cloud[first]
        seen = sum(sees(pose, cloud)[0].astype(int) for pose in self.poses)
        self.surface = cloud[seen >= 3]
        chosen = np.random.default_rng(1).choice(len(cloud), LANDMARKS, replace=False)
        self.landmarks = cloud[chosen]
        self.seen = [sees(pose, self.landmarks) for pose in self.poses]

    def name(self, view):
        return f"{'left' if view < VIEWS // 2 else 'right'}/{view}.png"

    def write_images(self, folder):
        for view, image in enumerate(self.images):
            path = folder / self.name(view)
            path.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(image).save(path)

    def write_model(self, folder, dense):
        """Writes a binary COLMAP model: the landmarks seen by two views or more, and with `dense` a point for each pixel."""
        folder.mkdir(parents=True)
        camera = struct.pack("<QIiQQ4d", 1, 1, 1, WIDTH, HEIGHT, FOCAL, FOCAL, *CENTRE)
        (folder / "cameras.bin").write_bytes(camera)
        shared = sum(seen.astype(int) for seen, _ in self.seen) >= 2
        tracks = {int(i): [] for i in np.flatnonzero(shared)}
        images, points = [struct.pack("<Q", VIEWS)], []
        record = np.dtype("<u8, <3f8, <3u1, <f8, <u8, <u4, <u4")
        for view, (rotation, translation) in enumerate(self.poses):
            seen, at = self.seen[view]
            ids = np.flatnonzero(seen & shared)
            keypoints = np.zeros(len(ids), "<f8, <f8, <u8")
            keypoints["f0"], keypoints["f1"], keypoints["f2"] = *at[ids].T, ids + 1
            for index, landmark in enumerate(ids):
                tracks[int(landmark)].append((view + 1, index))
            if dense:
                more = np.zeros(WIDTH * HEIGHT, keypoints.dtype)
                first = LANDMARKS + 1 + view * WIDTH * HEIGHT
                more["f0"], more["f1"] = pixels().T
                more["f2"] = first + np.arange(len(more))
                found = np.zeros(len(more), record)
                rays = rays_of(pixels(), rotation)
                place = -rotation.T @ translation + self.depths[view].reshape(-1, 1) * rays
                found["f0"], found["f1"], found["f3"], found["f4"] = more["f2"], place, 0.5, 1
                found["f5"], found["f6"] = view + 1, len(ids) + np.arange(len(more))
                points.append(found.tobytes())
                keypoints = np.concatenate([keypoints, more])
            quaternion = pycolmap.Rotation3d(rotation).quat[[3, 0, 1, 2]]
            images.append(struct.pack("<I7dI", view + 1, *quaternion, *translation, 1))
            images.append(self.name(view).encode() + b"\0" + struct.pack("<Q", len(keypoints)))
            images.append(keypoints.tobytes())
        (folder / "images.bin").write_bytes(b"".join(images))
        count = len(tracks) + (VIEWS * WIDTH * HEIGHT if dense else 0)
        for landmark, track in tracks.items():
            head = struct.pack("<Q3d3Bd", landmark + 1, *self.landmarks[landmark], 0, 0, 0, 0.5)
            ends = b"".join(struct.pack("<II", *end) for end in track)
            points.append(head + struct.pack("<Q", len(track)) + ends)
        (folder / "points3D.bin").write_bytes(struct.pack("<Q", count) + b"".join(points))
        return sum(int((seen & shared).sum()) for seen, _ in self.seen) / VIEWS


# ---- COLMAP ----


def check_maps(scene, folder, depths):
    """Checks the maps as read by pycolmap."""
    worst, angles = 0.0, []
    for view in range(VIEWS):
        name = f"{scene.name(view)}.geometric.bin"
        depth, normal = pycolmap.DepthMap(), pycolmap.NormalMap()
        depth.read(str(folder / "stereo/depth_maps" / name))
        normal.read(str(folder / "stereo/normal_maps" / name))
        worst = max(worst, np.abs(depth.to_array() - depths[view]).max())
        # COLMAP stores a matrix channel by channel; pycolmap 4.2.1 returns the bytes as if channels were innermost.
        found = normal.to_array().reshape(3, HEIGHT, WIDTH).transpose(1, 2, 0)
        cosines = (found * scene.normals[view]).sum(-1).clip(-1, 1)
        angles.append(np.degrees(np.arccos(cosines)).ravel())
    angles = np.concatenate(angles)
    shares = ", ".join(f"{(angles < limit).mean():.1%} within {limit}" for limit in (1, 5, 10))
    print(f"  maps: depth differs by {worst:.2g} at most; normals {shares} degrees of the exact ones")
    model = pycolmap.Reconstruction(folder / "sparse")
    print(f"  pycolmap {pycolmap.__version__} reads {model.num_images()} images, {model.num_points3D()} points")


def check_cloud(scene, cloud, title):
    accuracy = distance(cloud)
    completeness = cKDTree(cloud).query(scene.surface)[0]
    cells = "  ".join(
        f"{100 * limit:.0f} cm {(accuracy < limit).mean():6.1%} {(completeness < limit).mean():6.1%}"
        for limit in DISTANCES
    )
    print(f"  {title}: {len(cloud)} points; accuracy, completeness: {cells}")


def fuse(scene, folder):
    from plyfile import PlyData

    for title in ("colmap", "pycolmap"):
        path = folder / f"{title}.ply"
        if title == "colmap":
            arguments = ["--workspace_path", folder, "--output_path", path]
            subprocess.run(["colmap", "stereo_fusion", *arguments], check=True, capture_output=True)
        else:
            pycolmap.stereo_fusion(output_path=path, workspace_path=folder, output_type="PLY")
        vertices = PlyData.read(path)["vertex"]
        cloud = np.stack([vertices[axis] for axis in "xyz"], 1).astype(float)
        check_cloud(scene, cloud, f"stereo_fusion of {title}")


# ---- loaders of other programs ----


class Tensor(np.ndarray):
    """The part of torch's tensors that loaders use."""

    def to(self, *_):
        return self

    cuda = cpu = to

    def permute(self, *axes):
        return self.transpose(*axes)

    def clamp(self, low, high):
        return self.clip(low, high)

    def unsqueeze(self, axis):
        return np.expand_dims(self, axis)

    def bmm(self, other):
        return self @ other

    def inverse(self):
        return np.linalg.inv(self).view(Tensor)

    def transpose(self, *axes):
        return self.swapaxes(*axes) if len(axes) == 2 and self.ndim == 2 else super().transpose(*axes)


def stand_in_for_torch():
    torch = types.ModuleType("torch")
    as_tensor = lambda values, **_: np.asarray(values).view(Tensor)
    torch.from_numpy = torch.tensor = as_tensor
    torch.ones_like = lambda values: np.ones_like(values).view(Tensor)
    torch.zeros = lambda *shape: np.zeros(shape, np.float32).view(Tensor)
    torch.device, torch.Tensor = str, Tensor
    torch.nn = types.ModuleType("torch.nn")
    torch.nn.Module = object
    sys.modules |= {"torch": torch, "torch.nn": torch.nn}


def check_splatting(scene, folder, clone, depths):
    """Checks the scene as read by `train.py -s FOLDER -d depths`."""
    sys.path.insert(0, str(clone))
    # Other imports of the package need a GPU.
    package = types.ModuleType("scene")
    package.__path__ = [str(clone / "scene")]
    model = types.ModuleType("scene.gaussian_model")
    model.BasicPointCloud = tuple
    sys.modules |= {"scene": package, "scene.gaussian_model": model}
    readers = importlib.import_module("scene.dataset_readers")
    cameras = importlib.import_module("utils.camera_utils")
    readers.fetchPly = lambda _: None
    with contextlib.redirect_stdout(io.StringIO()):
        found = readers.readColmapSceneInfo(str(folder), "images", "depths", False, False)
    options = types.SimpleNamespace(resolution=1, data_device="cpu", train_test_exp=False)
    worst, reliable = 0.0, 0
    for info in found.train_cameras:
        camera = cameras.loadCam(options, 0, info, 1.0, False, False)
        view = int(pathlib.Path(info.image_name).stem)
        worst = max(worst, np.abs(camera.invdepthmap[0] - 1 / depths[view]).max())
        reliable += camera.depth_reliable
    scale = next(iter(json.loads((folder / "sparse/0/depth_params.json").read_text()).values()))["scale"]
    print(
        f"  {reliable} of {len(found.train_cameras)} depths reliable; inverse depth differs by {worst:.3g} at most, "
        f"half a step is {scale / 2**17:.3g}"
    )


def check_nerfstudio(scene, folder, clone, depths):
    """Checks depths with nerfstudio's own function, and poses in its axes with the exact surface."""
    read = None
    if clone:
        source = (clone / "nerfstudio/data/utils/data_utils.py").read_text()
        space = {}
        exec(compile(source, "data_utils.py", "exec"), space)  # the package imports everything that it has
        read = space["get_depth_image_from_path"]
    contents = json.loads((folder / "transforms.json").read_text())
    worst_depth = worst_pixel = 0.0
    for frame in contents["frames"]:
        view = int(pathlib.Path(frame["file_path"]).stem)
        path = folder / frame["depth_file_path"]
        if read:
            depth = np.asarray(read(path, frame["h"], frame["w"], 1e-3))[..., 0]
        else:
            depth = cv2.imread(str(path), -1) * 1e-3
        worst_depth = max(worst_depth, np.abs(depth - depths[view]).max())
        # Pixel centres at 0.5; the camera looks along -z, y is up.
        u, v = pixels().T
        x, y = (u - frame["cx"]) / frame["fl_x"], -(v - frame["cy"]) / frame["fl_y"]
        z = scene.depths[view].ravel()
        local = np.stack([x * z, y * z, -z, np.ones_like(z)])
        world = (np.array(frame["transform_matrix"]) @ local)[:3].T
        at, _ = project(world, scene.poses[view])
        worst_pixel = max(worst_pixel, np.abs(at - pixels()).max())
        assert (folder / frame["file_path"]).is_file()
    print(
        f"  {len(contents['frames'])} frames, {path.suffix[1:]}: depth differs by {worst_depth:.3g} at most; "
        f"exact depths by these cameras are {distance(world).max():.2g} off the surface, {worst_pixel:.2g} pixels"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("lsdc", type=pathlib.Path)
    parser.add_argument("--splatting", type=pathlib.Path)
    parser.add_argument("--nerfstudio", type=pathlib.Path)
    parser.add_argument("--work", type=pathlib.Path)
    options = parser.parse_args()
    work = options.work or pathlib.Path(tempfile.mkdtemp())
    shutil.rmtree(work, ignore_errors=True)
    scene = Scene()
    scene.write_images(work / "images")
    stand_in_for_torch()
    runs = [
        ("exact depth", "dense", ["--method", "nearest"]),
        ("completed from landmarks", "sparse", []),
        ("completed, above 2 % deviation left out", "sparse", ["--max-relative-sigma", "0.02"]),
    ]
    for title, model, arguments in runs:
        if not (work / model).exists():
            points = scene.write_model(work / model, dense=model == "dense")
            print(f"model {model}: {points:.0f} landmarks an image")
        folder = work / title.replace(" ", "_").replace(",", "").replace("%", "percent")
        command = [options.lsdc.resolve(), "complete", work / "images", work / model, "-o", folder, "--formats", "npy"]
        command += ["--export", "colmap,splatting,nerfstudio", *arguments]
        said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        print(f"{title}:")
        print("  " + "\n  ".join(line for line in said.splitlines() if line.startswith("exported")))
        stems = [folder / pathlib.Path(scene.name(view)).with_suffix("") for view in range(VIEWS)]
        depths = [np.load(f"{stem}_depth.npy") for stem in stems]
        errors = np.concatenate([(a - b).ravel() for a, b in zip(depths, scene.depths)])
        print(f"  depth: RMSE {np.sqrt((errors**2).mean()):.4f}, median {np.median(np.abs(errors)):.4f}")
        if "left out" not in title:
            check_maps(scene, folder / "colmap", depths)
            check_nerfstudio(scene, folder / "nerfstudio", options.nerfstudio, depths)
            if options.splatting:
                check_splatting(scene, folder / "splatting", options.splatting.resolve(), depths)
        fuse(scene, folder / "colmap")


if __name__ == "__main__":
    main()
