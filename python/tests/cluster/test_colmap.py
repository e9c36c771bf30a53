"""Models of COLMAP against numbers worked out by hand, and against pycolmap."""

import struct

import numpy as np
import pytest
from conftest import Image, as_png, command, frame, results
from numpy.testing import assert_allclose, assert_array_equal

import lsdc
import lsdc.ray
from lsdc.ray._colmap import Model, View
from lsdc.ray._place import Place

# A camera turned by 90 degrees about its vertical axis: it looks along -x of the world.
CAMERAS = "# Camera list\n1 SIMPLE_RADIAL 640 480 500 320 240 0.01\n"
IMAGES = (
    "# Image list with two lines of data per image:\n"
    "7 0.70710678118654757 0 0.70710678118654757 0 0 0 3 1 a view.jpg\n"
    "100.5 50.5 4 10 10 -1 200.25 300.75 5 320 240 6 1 1 99\n"
    "8 1 0 0 0 0 0 0 1 empty.jpg\n\n"
)
POINTS = (
    "# 3D point list\n4 -2 0 0 10 20 30 0.5 7 0 8 1 9 0\n5 -1 1 2 10 20 30 0.1 7 2\n6 4 0 0 10 20 30 0.5 7 3\n"
)


def write(folder, cameras=CAMERAS, images=IMAGES, points=POINTS):
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in (("cameras", cameras), ("images", images), ("points3D", points)):
        (folder / f"{name}.txt").write_text(text)
    return Place(str(folder))


def test_depths_are_those_along_the_optical_axis(tmp_path):
    views = Model(write(tmp_path)).views
    view = views["a view.jpg"]
    assert view.size == (640, 480) and len(views["empty.jpg"].keypoints) == 0
    # Along the axis lies -x + 3: 5 and 4 before the camera, -1 behind it; 99 is unknown. The deviation is the
    # reprojection error, 0.3 pixels at least, over the focal length and the root of the other images.
    expected = [[100, 50, 5, 5 * 0.5 / 500 / 2**0.5], [199.75, 300.25, 4, 4 * 0.3 / 500]]
    assert_allclose(view.keypoints, expected, rtol=1e-12)


def test_images_of_other_sizes_and_turned(tmp_path):
    view = Model(write(tmp_path)).views["a view.jpg"]
    assert_allclose(view.points((320, 240))[:, :2], (view.keypoints[:, :2] + 0.5) / 2 - 0.5)
    # EXIF 6: the first row is the right side.
    turned = view.points((640, 480), 6)
    assert_allclose(turned[0, :2], [480 - 1 - 50, 100])
    # EXIF 3: by 180 degrees.
    assert_allclose(view.points((640, 480), 3)[0, :2], [639 - 100, 479 - 50])
    # The model was made of images that had been turned already.
    assert_allclose(view.points((480, 640), 6), view.keypoints)
    with pytest.raises(lsdc.InputError, match="640x480 in the model"):
        view.points((500, 500))


def test_only_what_lies_behind_a_gap_is_hidden():
    rows = [[9, 9, 4.0, 0.01], [9.2, 9.1, 2.0, 0.01], [9.1, 9, 2.02, 0.01], [20, 9, 4.0, 0.01], [99, 9, 1.0, 0.01]]
    view = View("a", (64, 48), np.array(rows))
    assert_array_equal(view.points((64, 48))[:, 2], [2.0, 2.02, 4.0])
    vague = View("a", (64, 48), np.array([[9, 9, 1.0, 5.0], [9, 9, 3.0, 0.01]]))
    assert len(vague.points((64, 48))) == 2


@pytest.mark.parametrize(
    "part",
    [
        {"cameras": "1 SIMPLE_RADIAL 640 480 500\n"},
        {"cameras": "1 PINHOLE 640 480 -1 500 320 240\n"},
        {"images": "7 1 0 0 0 0 0 3 9 a.jpg\n\n"},
        {"images": "7 1 0 0 0 0 0 3\n\n"},
        {"images": "7 1 0 0 0 0 0 3 1 a.jpg\n1 2\n"},
        {"points": "4 -2 0 zero 10 20 30 0.5\n"},
    ],
)
def test_damaged_text(tmp_path, part):
    with pytest.raises(lsdc.ReadError):
        Model(write(tmp_path, **part))


def test_models_that_are_cut_off_or_promise_too_much(tmp_path):
    write(tmp_path)
    whole = struct.pack("<QIIQQ4d", 1, 1, 2, 640, 480, 500, 320, 240, 0.01)
    file = tmp_path / "cameras.bin"
    file.write_bytes(whole)
    # Binary files come first.
    assert Model(Place(str(tmp_path))).views["a view.jpg"].size == (640, 480)
    for length in range(len(whole)):
        file.write_bytes(whole[:length])
        with pytest.raises(lsdc.ReadError):
            Model(Place(str(tmp_path)))
    file.write_bytes(struct.pack("<Q", 2**60))
    with pytest.raises(lsdc.ReadError, match="promises"):
        Model(Place(str(tmp_path)))
    with pytest.raises(lsdc.ReadError, match="holds no"):
        Model(Place(str(tmp_path / "nothing")))


@pytest.mark.parametrize("model", ["SIMPLE_PINHOLE", "OPENCV", "OPENCV_FISHEYE"])
def test_files_of_pycolmap(tmp_path, model):
    pycolmap = pytest.importorskip("pycolmap")
    pycolmap.set_random_seed(0)
    options = pycolmap.SyntheticDatasetOptions()
    options.camera_model_id = getattr(pycolmap.CameraModelId, model)
    lens = {"SIMPLE_PINHOLE": [], "OPENCV": [0.05, -0.02, 1e-3, -1e-3], "OPENCV_FISHEYE": [0.05, -0.02, 0, 0]}
    two = [] if model == "SIMPLE_PINHOLE" else [1280.0]
    options.camera_params = [1280.0, *two, 512.0, 384.0, *lens[model]]
    theirs = pycolmap.synthesize_dataset(options)
    for name in ("text", "binary"):
        folder = tmp_path / name
        folder.mkdir()
        getattr(theirs, f"write_{name}")(folder)
        ours = Model(Place(str(folder)))
        assert len(ours.views) == theirs.num_images() > 0
        for image in theirs.images.values():
            seen = [(p.xy, theirs.points3D[p.point3D_id].xyz) for p in image.points2D if p.has_point3D()]
            world = np.array([place for _, place in seen])
            pose = image.cam_from_world().matrix()
            depth = world @ pose[2, :3] + pose[2, 3]
            found = ours.views[image.name].keypoints
            assert_allclose(found[:, :2] + 0.5, [place for place, _ in seen], rtol=1e-12)
            assert_allclose(found[:, 2], depth, rtol=1e-9)
            # Made without noise, points are seen where our own cameras project them.
            camera = lsdc.Camera(
                (1280, 1280),
                (511.5, 383.5),
                lens={"SIMPLE_PINHOLE": "pinhole", "OPENCV": "radtan"}.get(model, "fisheye"),
                coefficients=lens[model],
                rotation=pose[:, :3],
                translation=pose[:, 3],
            )
            assert_allclose(camera.project(world), found[:, :3], rtol=1e-6, atol=1e-6)


def test_the_command(cluster, tmp_path):
    source, dest = tmp_path / "scene", tmp_path / "out"
    image, sparse = frame(0)
    down, across = np.nonzero(sparse)
    depth = sparse[down, across]
    # With a focal length of 1 and the camera in the origin, a point is its direction times its depth.
    points, seen = [], []
    for number, (x, y, z) in enumerate(zip(across, down, depth.tolist(), strict=True)):
        points.append(f"{number} {x * z} {y * z} {z} 0 0 0 0.5 1 0 2 0")
        seen.append(f"{x + 0.5} {y + 0.5} {number}")
    write(
        source / "sparse/0",
        "1 PINHOLE 64 48 1 1 0.5 0.5\n",
        f"1 1 0 0 0 0 0 0 1 views/a.png\n{' '.join(seen)}\n2 1 0 0 0 0 0 0 1 missing.png\n\n",
        "\n".join(points),
    )
    (source / "images/views").mkdir(parents=True)
    (source / "images/views/a.png").write_bytes(as_png(image))
    assert command(source, dest, "--encoding", "f32") == 3
    missing, row = results(dest)
    assert (missing["key"], row["key"]) == ("missing", "views/a") and "missing.png" in missing["error"]
    table = np.column_stack([across, down, depth, depth * 0.5])
    expected = lsdc.Completer("small").complete(image, table).depth
    assert_array_equal(lsdc.ray.decode(row), expected)


def test_the_same_numbers_as_the_program(tmp_path):
    import os
    import subprocess
    from pathlib import Path

    program = Path(os.environ.get("LSDC_PROGRAM", Path(__file__).parents[3] / "target/release/lsdc"))
    if not program.exists():
        pytest.skip("the program is not built")
    rng = np.random.default_rng(0)
    x, y, z = rng.uniform(0, 64, 300), rng.uniform(0, 48, 300), rng.uniform(1, 4, 300)
    points = [
        f"{i} {(x[i] - 32) / 50 * z[i]!r} {(y[i] - 24) / 50 * z[i]!r} {z[i]!r} 0 0 0 {rng.uniform(0.1, 1)!r} "
        + "1 0 " * rng.integers(1, 6)
        for i in range(300)
    ]
    seen = " ".join(f"{x[i]!r} {y[i]!r} {i}" for i in range(300))
    text = [line.replace("np.float64(", "").replace(")", "") for line in (*points, seen)]
    place = write(
        tmp_path / "model",
        "1 PINHOLE 64 48 50 50 32 24\n",
        f"1 1 0 0 0 0 0 0 1 a.png\n{text[-1]}\n",
        "\n".join(text[:-1]),
    )
    (tmp_path / "images").mkdir()
    # Twice as large as in the model.
    image = np.kron(frame(3)[0], np.ones((2, 2, 1), np.uint8))
    Image.fromarray(image).save(tmp_path / "images/a.png")
    arguments = [program, "complete", tmp_path / "images", place.address, "-o", tmp_path / "out", "--weights", "small"]
    subprocess.run([*arguments, "--quiet"], check=True)
    table = Model(place).views["a.png"].points((128, 96))
    depth = lsdc.Completer("small").complete(image, table).depth
    assert_array_equal(depth, np.load(tmp_path / "out/a_depth.npy"))
