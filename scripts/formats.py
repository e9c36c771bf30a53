#!/usr/bin/env python3
"""Exchange of files with other programs, in both directions.

Writes the points of the room in `assets/` in every format with NumPy, tifffile, OpenEXR, OpenCV, netpbmfile, h5py,
plyfile, pypcd4, laspy, Open3D and pycolmap, completes each, and compares the results with that of the npy map; then reads
the result back in every format. Clouds are in the world of a camera with OpenCV's lens distortion.

    pip install numpy tifffile OpenEXR netpbmfile h5py opencv-python-headless plyfile pypcd4 'laspy[lazrs]' pycolmap open3d
    python3 scripts/formats.py [PROGRAM]
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import h5py
import laspy
import netpbmfile
import numpy as np
import open3d
import OpenEXR
import plyfile
import pycolmap
import tifffile
from pypcd4 import Encoding, PointCloud

ROOT = Path(__file__).resolve().parent.parent
ROOM = ROOT / "assets/room"


def exr(path: Path, name: str, values: np.ndarray) -> None:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {name: values}).write(str(path))


def inputs(folder: Path, sparse: np.ndarray) -> dict[str, float]:
    """Writes the points in every format; returns the tolerance of results in metres."""
    v, u = np.nonzero(sparse)
    points = np.column_stack([u, v, sparse[v, u]])
    millimetres = np.round(sparse * 1000).astype(np.uint16)
    np.save(folder / "f64.npy", np.asfortranarray(sparse.astype(np.float64)))
    np.save(folder / "f16.npy", sparse.astype(np.float16))
    np.save(folder / "u16.npy", millimetres)
    np.save(folder / "list.npy", points)
    np.savez(folder / "plain.npz", depth=sparse)
    np.savez_compressed(folder / "small.npz", other=u, sparse=sparse)
    np.savetxt(folder / "commas.csv", points, delimiter=",", fmt="%.6f", header="u,v,depth", comments="")
    np.savetxt(folder / "blanks.txt", points, fmt="%.6f")
    tifffile.imwrite(folder / "f32.tiff", sparse)
    tifffile.imwrite(folder / "deflated.tif", sparse.astype(np.float64), compression="deflate", tile=(64, 64))
    tifffile.imwrite(folder / "u16.tif", millimetres, byteorder=">")
    exr(folder / "z.exr", "Z", sparse)
    exr(folder / "half.exr", "Y", sparse.astype(np.float16))
    cv2.imwrite(str(folder / "cv.pfm"), sparse)
    cv2.imwrite(str(folder / "cv.png"), millimetres)
    netpbmfile.imwrite(folder / "maxval.pgm", millimetres, maxval=20000)
    cv2.imwrite(str(folder / "largest.png"), np.where(sparse > 0, millimetres, 65535))
    tifffile.imwrite(folder / "white.tiff", millimetres, photometric="miniswhite")
    nodata = [(42113, 2, 0, "-9999", True)]
    tifffile.imwrite(folder / "nodata.tiff", np.where(sparse > 0, sparse, np.float32(-9999)), extratags=nodata)
    exr(folder / "background.exr", "ViewLayer.Depth.Z", np.where(sparse > 0, sparse, np.float32(1e10)))
    with h5py.File(folder / "group.h5", "w") as file:
        file.create_group("cam").create_dataset("depth", data=millimetres, compression="gzip", fillvalue=65535)
    exact = {"f64.npy", "list.npy", "plain.npz", "small.npz", "f32.tiff", "deflated.tif", "z.exr", "cv.pfm"}
    exact |= {"nodata.tiff", "background.exr"}
    return {
        path.name: 1e-5 if path.name in exact else 1e-3 if path.suffix in (".csv", ".txt") else 2e-2
        for path in sorted(folder.iterdir())
    }


def run(program: str, *args: object) -> None:
    subprocess.run([program, "complete", *map(str, args)], check=True, stdout=subprocess.DEVNULL)


def model(folder: Path, sparse: np.ndarray) -> None:
    """Writes the points as a COLMAP model, seen by one camera and by a second beside it."""
    height, width = sparse.shape
    camera = pycolmap.Camera(model="OPENCV", width=width, height=height,
                             params=[300.0, 300.0, width / 2, height / 2, 0.0, 0.0, 0.0, 0.0], camera_id=1)
    v, u = np.nonzero(sparse)
    depth = sparse[v, u].astype(np.float64)
    place = np.column_stack([(u + 0.5 - width / 2) * depth / 300, (v + 0.5 - height / 2) * depth / 300, depth])
    found = pycolmap.Reconstruction()
    found.add_camera_with_trivial_rig(camera)
    for number, name in ((1, "rgb.png"), (2, "other.png")):
        image = pycolmap.Image(name=name, camera_id=1, image_id=number)
        image.points2D = pycolmap.Point2DList(
            [pycolmap.Point2D(np.array([x + 0.5, y + 0.5])) for x, y in zip(u, v)])
        found.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
    for i, xyz in enumerate(place):
        track = pycolmap.Track()
        track.add_element(1, i)
        track.add_element(2, i)
        found.add_point3D(xyz, track, np.zeros(3, np.uint8))
    for form in ("bin", "txt"):
        (folder / form).mkdir()
    found.write_binary(str(folder / "bin"))
    found.write_text(str(folder / "txt"))


CAMERA = np.array([[310.0, 0.0, 150.0], [0.0, 305.0, 116.0], [0.0, 0.0, 1.0]])
LENSES = {
    "radtan": [0.08, -0.05, 0.001, -0.002, 0.01],
    "fisheye": [0.02, -0.01, 0.004, -0.001],
}
# The camera is far from the origin, as in maps, and looks along the world's x axis.
TO_WORLD = np.array([[0.0, 0.0, 1.0, 4512.0], [-1.0, 0.0, 0.0, -218.0], [0.0, -1.0, 0.0, 37.0], [0.0, 0.0, 0.0, 1.0]])


def camera_file(path: Path, model: str) -> None:
    rows = ", ".join(str(row) for row in TO_WORLD[:3].tolist())
    path.write_text(
        f"fx = {CAMERA[0, 0]}\nfy = {CAMERA[1, 1]}\ncx = {CAMERA[0, 2]}\ncy = {CAMERA[1, 2]}\n"
        f"model = '{model}'\ndistortion = {LENSES[model]}\ncamera_to_world = [{rows}]\n")


def unproject(u: np.ndarray, v: np.ndarray, depth: np.ndarray, model: str) -> np.ndarray:
    pixels = np.column_stack([u, v]).astype(np.float64).reshape(-1, 1, 2)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    if model == "fisheye":
        rays = cv2.fisheye.undistortPoints(pixels, CAMERA, np.array(LENSES[model]), criteria=criteria)
    else:
        rays = cv2.undistortPoints(pixels, CAMERA, np.array(LENSES[model]), criteria=criteria)
    rays = np.column_stack([rays.reshape(-1, 2), np.ones(len(u))])
    return rays * depth[:, None] @ TO_WORLD[:3, :3].T + TO_WORLD[:3, 3]


def clouds(folder: Path, places: np.ndarray) -> dict[str, float]:
    """Writes positions in space in every format; returns the tolerance of depths in metres."""
    vertices = np.array([tuple(p) for p in places], dtype=[("x", "f8"), ("y", "f8"), ("z", "f8")])
    faces = np.array([([0, 1, 2],)], dtype=[("vertex_indices", "i4", (3,))])
    for name, text, order in (("text", True, "="), ("little", False, "<"), ("big", False, ">")):
        elements = [plyfile.PlyElement.describe(vertices, "vertex"), plyfile.PlyElement.describe(faces, "face")]
        plyfile.PlyData(elements, text=text, byte_order=order).write(str(folder / f"{name}.ply"))
    fields, types = ("x", "y", "z", "intensity"), (np.float64, np.float64, np.float64, np.float32)
    cloud = PointCloud.from_points([*places.T, np.ones(len(places))], fields, types)
    for name, encoding in (("text", Encoding.ASCII), ("binary", Encoding.BINARY), ("packed", Encoding.BINARY_COMPRESSED)):
        cloud.save(folder / f"{name}.pcd", encoding=encoding)
    for name, version, kind in (("old.las", "1.2", 1), ("new.las", "1.4", 6), ("new.laz", "1.4", 7)):
        header = laspy.LasHeader(version=version, point_format=kind)
        header.offsets, header.scales = np.floor(places.min(axis=0)), np.full(3, 1e-4)
        scan = laspy.LasData(header)
        scan.x, scan.y, scan.z = places.T
        scan.write(str(folder / name))
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(places))
    for name, options in (("open3d.ply", {}), ("open3d.pcd", {"compressed": True})):
        open3d.io.write_point_cloud(str(folder / name), cloud, **options)
    # Resolution of scans, and of float32 kilometres from the origin.
    coarse = {"old.las", "new.las", "new.laz", "open3d.pcd"}
    return {path.name: 1e-4 if path.name in coarse else 1e-5 for path in sorted(folder.iterdir())}


def check_clouds(program: str, at: Path, sparse: np.ndarray) -> None:
    v, u = np.nonzero(sparse)
    print("\n| cloud read by lsdc | largest difference of the result (m) |\n|---|---|")
    for lens in LENSES:
        camera_file(at / f"{lens}.toml", lens)
        (at / lens).mkdir()
        bounds = clouds(at / lens, unproject(u, v, sparse[v, u].astype(np.float64), lens))
        expected = None
        for name, bound in bounds.items():
            run(program, ROOM / "rgb.png", at / lens / name, "--camera", at / f"{lens}.toml",
                "-o", at / f"{lens}-{name}.npy")
            result = np.load(at / f"{lens}-{name}.npy")
            expected = result if expected is None else expected
            worst = np.abs(result - expected).max()
            print(f"| {name}, {lens} | {worst:.2g} |")
            assert worst <= 20 * bound, f"{name}: {worst}"
        run(program, ROOM / "rgb.png", ROOM / "sparse.npy", "-o", at / f"{lens}-map.npy")
        rel = np.abs(expected / np.load(at / f"{lens}-map.npy") - 1).mean()
        print(f"| all of {lens}, to the map | REL {rel:.4f} |")
        # Only hidden points are missing.
        assert rel < 0.01

    print("\n| cloud written by lsdc | largest difference to npy (m; pixels) |\n|---|---|")
    image = cv2.imread(str(ROOM / "rgb.png"))[..., ::-1]
    for lens in LENSES:
        args = ["--camera", at / f"{lens}.toml"]
        run(program, ROOM / "rgb.png", ROOM / "sparse.npy", *args, "-o", at / f"{lens}-out.ply")
        vertex = plyfile.PlyData.read(str(at / f"{lens}-out.ply"))["vertex"]
        places = np.column_stack([vertex[axis] for axis in "xyz"])
        rotation, origin = TO_WORLD[:3, :3], TO_WORLD[:3, 3]
        seen = (places - origin) @ rotation
        module = cv2.fisheye if lens == "fisheye" else cv2
        pixels = module.projectPoints(seen.reshape(1, -1, 3) if lens == "fisheye" else seen, np.zeros(3),
                                      np.zeros(3), CAMERA, np.array(LENSES[lens]))[0].reshape(-1, 2)
        nearest = np.round(pixels).astype(int)
        depth = np.load(at / f"{lens}-map.npy")
        off = np.abs(pixels - nearest).max()
        worst = np.abs(depth[nearest[:, 1], nearest[:, 0]] - seen[:, 2]).max()
        colours = np.column_stack([vertex[name] for name in ("red", "green", "blue")])
        print(f"| ply, {lens} | {worst:.2g}; {off:.2g} |")
        assert worst < 1e-5 and off < 1e-3 and len(places) > 0.99 * depth.size
        assert (colours == image[nearest[:, 1], nearest[:, 0]]).all()
        cloud = open3d.io.read_point_cloud(str(at / f"{lens}-out.ply"))
        again = np.round(np.asarray(cloud.colors) * 255)
        worst = np.abs(np.asarray(cloud.points) - places).max()
        print(f"| ply, {lens}, by Open3D | {worst:.2g} to plyfile |")
        assert worst == 0 and (again == colours).all()


def check_images(program: str, at: Path) -> None:
    image = cv2.imread(str(ROOM / "rgb.png"))
    cv2.imwrite(str(at / "lossless.webp"), image, [cv2.IMWRITE_WEBP_QUALITY, 101])
    cv2.imwrite(str(at / "deep.png"), image.astype(np.uint16) * 257)
    tifffile.imwrite(at / "image.tiff", image[..., ::-1])
    tifffile.imwrite(at / "deep.tiff", image[..., ::-1].astype(np.uint16) * 257, compression="deflate")
    run(program, ROOM / "rgb.png", ROOM / "sparse.npy", "-o", at / "expected.npy")
    print("\n| image read by lsdc | largest difference of the result (m) |\n|---|---|")
    for name in ("lossless.webp", "deep.png", "image.tiff", "deep.tiff"):
        run(program, at / name, ROOM / "sparse.npy", "-o", at / f"{name}.npy")
        worst = np.abs(np.load(at / f"{name}.npy") - np.load(at / "expected.npy")).max()
        print(f"| {name} | {worst:.2g} |")
        assert worst == 0, name


def main(program: str = str(ROOT / "target/release/lsdc")) -> None:
    sparse = np.load(ROOM / "sparse.npy")
    with tempfile.TemporaryDirectory() as temporary:
        at = Path(temporary)
        (at / "in").mkdir()
        bounds = inputs(at / "in", sparse)
        run(program, ROOM / "rgb.png", ROOM / "sparse.npy", "-o", at / "out", "--uncertainty",
            "--formats", "npy,npz,png,tiff,exr,pfm")
        depth, sigma = np.load(at / "out/rgb_depth.npy"), np.load(at / "out/rgb_sigma.npy")

        print("| read by lsdc | largest difference of the result (m) |\n|---|---|")
        for name, bound in bounds.items():
            run(program, ROOM / "rgb.png", at / "in" / name, "-o", at / f"{name}.npy")
            worst = np.abs(np.load(at / f"{name}.npy") - depth).max()
            print(f"| {name} | {worst:.2g} |")
            assert worst <= bound, f"{name}: {worst} above {bound}"
        model(at, sparse)
        (at / "images").mkdir()
        for name in ("rgb.png", "other.png"):
            (at / "images" / name).write_bytes((ROOM / "rgb.png").read_bytes())
        results = []
        for form in ("bin", "txt"):
            run(program, at / "images", at / form, "-o", at / f"colmap-{form}", "--formats", "npy")
            results += [np.load(at / f"colmap-{form}" / f"{name}_depth.npy") for name in ("rgb", "other")]
        worst = max(np.abs(result - results[0]).max() for result in results)
        rel = (np.abs(results[0] - depth) / depth).mean()
        print(f"| COLMAP, binary and text | {worst:.2g} between them, REL {rel:.3f} to the map |")
        assert worst < 1e-4 and rel < 0.05

        out = at / "out"
        archive = np.load(out / "rgb_depth.npz")
        layers = OpenEXR.File(str(out / "rgb_depth.exr")).channels()
        back = {
            "npz (NumPy)": archive["depth"],
            "npz, sigma": archive["sigma"] - sigma + depth,
            "tiff (tifffile)": tifffile.imread(out / "rgb_depth.tiff"),
            "exr (OpenEXR)": layers["Z"].pixels,
            "exr, sigma": layers["sigma"].pixels - sigma + depth,
            "pfm (OpenCV)": cv2.imread(str(out / "rgb_depth.pfm"), cv2.IMREAD_UNCHANGED),
            "png (OpenCV)": cv2.imread(str(out / "rgb_depth.png"), cv2.IMREAD_UNCHANGED) / 1000,
        }
        print("\n| written by lsdc | largest difference to npy (m) |\n|---|---|")
        for name, values in back.items():
            worst = np.abs(values - depth).max()
            print(f"| {name} | {worst:.2g} |")
            assert worst <= (5.1e-4 if "png" in name else 1e-6), name
        check_clouds(program, at, sparse)
        check_images(program, at)


if __name__ == "__main__":
    main(*sys.argv[1:])
