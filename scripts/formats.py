#!/usr/bin/env python3
"""Files of other programs read by lsdc, and its files read by them.

Writes the points of the room in `assets/` in every form with NumPy, tifffile, OpenEXR, OpenCV and
pycolmap, completes each, and compares the results with that of the npy map; then reads every form
of the result back.

    pip install numpy tifffile OpenEXR opencv-python-headless pycolmap
    python3 scripts/formats.py [PROGRAM]
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pycolmap
import tifffile

ROOT = Path(__file__).resolve().parent.parent
ROOM = ROOT / "assets/room"


def exr(path: Path, name: str, values: np.ndarray) -> None:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {name: values}).write(str(path))


def inputs(folder: Path, sparse: np.ndarray) -> dict[str, float]:
    """Writes the points in every form; says how far results may be off, in metres."""
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
    exact = {"f64.npy", "list.npy", "plain.npz", "small.npz", "f32.tiff", "deflated.tif", "z.exr", "cv.pfm"}
    return {
        path.name: 1e-5 if path.name in exact else 1e-3 if path.suffix in (".csv", ".txt") else 2e-2
        for path in sorted(folder.iterdir())
    }


def run(program: str, *args: object) -> None:
    subprocess.run([program, "complete", *map(str, args)], check=True, stdout=subprocess.DEVNULL)


def model(folder: Path, sparse: np.ndarray) -> None:
    """The points as seen by one camera, and by a second beside it, as COLMAP keeps them."""
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
            run(program, ROOM / "rgb.png", at / "in" / name, "-o", at / name, "--formats", "npy")
            worst = np.abs(np.load(at / name / "rgb_depth.npy") - depth).max()
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


if __name__ == "__main__":
    main(*sys.argv[1:])
