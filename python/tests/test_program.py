"""The package gives the same numbers as the program.

`LSDC_PROGRAM` is the program; by default, the one built by cargo, if there is one.
"""

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

import lsdc

ROOT = Path(__file__).parents[2]
ROOM = ROOT / "assets/room"
PROGRAM = Path(os.environ.get("LSDC_PROGRAM", ROOT / "target/release/lsdc"))
Image = pytest.importorskip("PIL.Image")


@pytest.fixture(scope="module")
def room():
    return np.asarray(Image.open(ROOM / "rgb.png")), np.load(ROOM / "sparse.npy")


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Results that the program writes for the room."""
    if "LSDC_PROGRAM" not in os.environ and not PROGRAM.exists():
        pytest.skip("the program is not built")
    folder = tmp_path_factory.mktemp("program")

    def run(name, sparse, *options):
        out = folder / name
        command = [PROGRAM, "complete", ROOM / "rgb.png", sparse, "-o", out, "--quiet", *options]
        subprocess.run(command, check=True)
        return out

    return run


def test_the_room_to_the_bit(room, results):
    out = results("plain", ROOM / "sparse.npy", "--uncertainty")
    image, sparse = room
    completion = lsdc.Completer().complete(image, sparse)
    np.testing.assert_array_equal(completion.depth, np.load(out / "rgb_depth.npy"))
    np.testing.assert_array_equal(completion.standard_deviation, np.load(out / "rgb_sigma.npy"))
    np.testing.assert_array_equal(lsdc.complete(image, sparse), completion.depth)
    assert completion.report["used"] == 500


def test_millimetres_sizes_and_robust_fits_to_the_bit(room, results, tmp_path):
    image, sparse = room
    millimetres = np.rint(sparse * 1000).astype(np.uint16)
    Image.fromarray(millimetres).save(tmp_path / "sparse.png")
    options = ("--depth-unit", "mm", "--robust", "auto", "--size", "400x300", "--weights", "small")
    out = results("other", tmp_path / "sparse.png", *options)
    found = lsdc.complete(image, millimetres, unit="mm", robust="auto", size=(400, 300), weights="small")
    np.testing.assert_array_equal(found, np.load(out / "rgb_depth.npy"))


def test_maps_of_fewer_pixels_to_the_bit(room, results, tmp_path):
    image, sparse = room
    low = sparse[::2, ::2]
    np.save(tmp_path / "low.npy", low)
    out = results("low", tmp_path / "low.npy", "--weights", "small")
    found = lsdc.complete(image, low, weights="small")
    np.testing.assert_array_equal(found, np.load(out / "rgb_depth.npy"))


def test_pictures_in_files_to_the_bit(room, results, tmp_path):
    image, sparse = room
    Image.fromarray(image).save(tmp_path / "room.jpg", quality=80)
    out = tmp_path / "out"
    command = [PROGRAM, "complete", tmp_path / "room.jpg", ROOM / "sparse.npy", "-o", out, "--weights", "small", "--quiet"]
    results("first", ROOM / "sparse.npy")
    subprocess.run(command, check=True)
    found = lsdc.complete(tmp_path / "room.jpg", sparse, weights="small")
    np.testing.assert_array_equal(found, np.load(out / "room_depth.npy"))


def test_the_best_weights_to_the_bit(room, results):
    try:
        found = lsdc.complete(*room, weights="anything")
    except lsdc.ReadError as error:
        pytest.skip(str(error))
    out = results("anything", ROOM / "sparse.npy", "--weights", "anything")
    np.testing.assert_array_equal(found, np.load(out / "rgb_depth.npy"))


def test_clouds_are_those_of_the_program(room, results):
    options = ("--formats", "ply", "--camera", "260,260,151.5,113.5", "--voxel", "0.05", "--max-sigma", "0.2")
    out = results("cloud", ROOM / "sparse.npy", "--weights", "small", *options)
    written = (out / "rgb_cloud.ply").read_bytes()
    head, _, body = written.partition(b"end_header\n")
    rows = np.frombuffer(body, np.dtype([("place", "<f4", 3), ("color", "u1", 3), ("sigma", "<f4")]))
    camera = lsdc.Camera((260, 260), (151.5, 113.5))
    completion = lsdc.Completer("small").complete(*room)
    cloud = completion.point_cloud(camera, voxel=0.05, max_sigma=0.2)
    assert 0 < len(cloud.points) < len(completion.point_cloud(camera, voxel=0.05).points)
    np.testing.assert_array_equal(rows["place"], cloud.points)
    np.testing.assert_array_equal(rows["color"], cloud.colors)
    np.testing.assert_array_equal(rows["sigma"], cloud.sigma)


def test_the_picture_is_that_of_the_program(room, results):
    completion = lsdc.Completer().complete(*room)
    low, high = np.quantile(completion.depth, [0.01, 0.99])
    out = results("picture", ROOM / "sparse.npy", "--range", f"{low},{high}")
    expected = np.asarray(Image.open(out / "rgb_depth_color.png").convert("RGB"), dtype=int)
    # Remove the colour scale below the map.
    expected = expected[: completion.depth.shape[0]]
    from io import BytesIO

    shown = Image.open(BytesIO(completion._repr_png_()))
    # Colours are rounded differently.
    assert np.abs(np.asarray(shown, dtype=int) - expected).max() <= 1
