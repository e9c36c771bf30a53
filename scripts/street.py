#!/usr/bin/env python3
"""Draws the street of the README: a photograph, the points of COLMAP in it, the completed depth and its standard deviation.

    git clone https://github.com/mapillary/OpenSfM
    cp -r OpenSfM/data/lund/images street/images
    colmap feature_extractor --database_path street/db --image_path street/images --ImageReader.single_camera 1 \\
        --ImageReader.camera_params 995,512,384,0
    colmap sequential_matcher --database_path street/db
    colmap mapper --database_path street/db --image_path street/images --output_path street \\
        --Mapper.ba_refine_focal_length 0 --Mapper.init_min_tri_angle 4 --Mapper.init_max_forward_motion 0.999
    colmap model_converter --input_path street/0 --output_path street/0 --output_type TXT
    python3 scripts/street.py street/images/05.jpg street/0 street.jpg [--program lsdc]

The focal length is that of the EXIF data. Needs COLMAP, numpy, Pillow, and the weights `anything`. Lengths are in the unit of
the model.
"""

import argparse
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from overview import sheet
from PIL import Image


def rotation(quaternion: np.ndarray) -> np.ndarray:
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


def keypoints(model: Path, name: str) -> list[tuple[float, float, float]]:
    """Returns x, y in pixels from the centre of the first, and depth, of each keypoint with a point in space."""
    def lines(file: str) -> list[list[str]]:
        return [line.split() for line in (model / file).read_text().splitlines() if not line.startswith("#")]

    places = {line[0]: np.array(line[1:4], float) for line in lines("points3D.txt")}
    rows = lines("images.txt")
    heading, found = next((rows[i], rows[i + 1]) for i in range(0, len(rows), 2) if rows[i][9] == name)
    turn, shift = rotation(np.array(heading[1:5], float)), np.array(heading[5:8], float)
    triples = zip(found[::3], found[1::3], found[2::3])
    return [(float(x) - 0.5, float(y) - 0.5, float((turn @ places[point] + shift)[2]))
            for x, y, point in triples if point != "-1"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("image", type=Path)
    parser.add_argument("model", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--program", default="lsdc")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        command = [given.program, "complete", given.image, given.model, "-o", folder,
                   "--uncertainty", "--weights", "anything", "--robust", "auto", "--quiet"]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        depth, sigma = (np.load(f"{folder}/{given.image.stem}_{name}.npy") for name in ("depth", "sigma"))
    rgb = np.asarray(Image.open(given.image).convert("RGB"))
    points = keypoints(given.model, given.image.name)
    sheet(rgb, points, depth, sigma, "units").save(given.out, quality=85, optimize=True)


if __name__ == "__main__":
    main()
