"""COLMAP models on disks and in stores give the same bits as the program."""

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from conftest import Image, as_png, command, frame, results
from numpy.testing import assert_array_equal

import lsdc
import lsdc.ray
from lsdc.ray._place import Place
from lsdc.ray._plan import planned
from lsdc.ray._sources import opened

PROGRAM = Path(os.environ.get("LSDC_PROGRAM", Path(__file__).parents[3] / "target/release/lsdc"))


@pytest.fixture
def scene(tmp_path):
    """Images, and a model with 300 points in one of them, one of which is behind the camera."""
    rng = np.random.default_rng(0)
    x, y, z = (rng.uniform(low, high, 300) for low, high in ((0, 64), (0, 48), (1, 4)))
    z[7] = -1
    error, others = rng.uniform(0.1, 1, 300), rng.integers(1, 6, 300)
    rows = np.column_stack([(x - 32) / 50 * z, (y - 24) / 50 * z, z, np.zeros((300, 3)), error])
    points = [f"{i} {' '.join(map(str, row))} {'1 0 2 0 ' * n}" for i, (row, n) in enumerate(zip(rows.tolist(), others))]
    seen = " ".join(f"{a} {b} {i}" for i, (a, b) in enumerate(zip(x.tolist(), y.tolist())))
    files = {
        "sparse/0/cameras.txt": b"1 PINHOLE 64 48 50 50 32 24\n",
        "sparse/0/images.txt": f"1 1 0 0 0 0 0 0 1 views/a.png\n{seen}\n2 1 0 0 0 -0.2 0 0 1 missing.png\n\n".encode(),
        "sparse/0/points3D.txt": "\n".join(points).encode(),
        # Twice as large as in the model.
        "images/views/a.png": as_png(np.kron(frame(3)[0], np.ones((2, 2, 1), np.uint8))),
    }
    place = Place(str(tmp_path / "scene"))
    for name, data in files.items():
        place.write(name, data)
    place.clean()
    return place


def test_the_bits_of_the_program(cluster, scene, tmp_path):
    assert command(scene, tmp_path / "out", "--encoding", "f32", "--standard-deviation") == 3
    missing, row = results(tmp_path / "out")
    assert (missing["key"], row["key"]) == ("missing", "views/a") and "missing.png" in missing["error"]
    report = json.loads(row["report"])
    assert report["left_out"]["unusable"] == 1
    assert report["used"] + sum(report["left_out"].values()) == 300
    if not PROGRAM.exists():
        pytest.skip("the program is not built")
    folders = [f"{scene}/images", f"{scene}/sparse/0", "-o", tmp_path / "program"]
    arguments = ["--weights", "small", "--uncertainty", "--quiet"]
    found = subprocess.run([PROGRAM, "complete", *folders, *arguments], capture_output=True)
    # The program completes the images in the folder, so it reports no missing ones.
    assert found.returncode == 0
    for name, column in (("depth", "depth"), ("sigma", "standard_deviation")):
        expected = np.load(tmp_path / f"program/views/a_{name}.npy")
        assert_array_equal(lsdc.ray.decode(row, column), expected)


def test_images_that_are_stored_turned(scene):
    picture = Image.open(f"{scene}/images/views/a.png")
    exif = Image.Exif()
    exif[0x0112] = 6
    picture.save(f"{scene}/images/views/a.png", exif=exif)
    source = opened(str(scene), None, {})
    (shard,) = planned(source, 9).shards
    frames = {found.key: found for found in source.frames(json.loads(shard.reference))}
    inputs = frames["views/a"].decode()
    assert inputs.image.size == (96, 128)
    model = lsdc.Colmap(f"{scene}/sparse/0")
    with pytest.warns(lsdc.FileWarning):
        assert_array_equal(inputs.sparse, model.points("views/a.png", size=(128, 96), exif=6))


def test_models_in_a_store(scene, store):
    there = Place(store("scene"))
    for name in scene.files():
        there.write(name, scene.read(name))
    here, found = opened(str(scene), None, {}), opened(there.address, None, {})
    assert planned(found, 9) == planned(here, 9)
    there.write("sparse/0/points3D.txt", b"7 nowhere")
    with pytest.raises(lsdc.ReadError, match="s3://bucket/scene/sparse/0/points3D.txt") as caught:
        planned(opened(there.address, None, {}), 9)
    assert "secret" not in str(caught.value)
