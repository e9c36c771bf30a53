"""Files: reads what other programs wrote, and reports guesses."""

import struct
import warnings

import numpy as np
import pytest

import lsdc

Image = pytest.importorskip("PIL.Image")


@pytest.fixture(autouse=True)
def nothing_is_guessed():
    with warnings.catch_warnings():
        warnings.simplefilter("error", lsdc.FileWarning)
        yield


def test_maps_of_numpy_and_pillow(sparse, tmp_path):
    np.save(tmp_path / "a.npy", sparse)
    np.testing.assert_array_equal(lsdc.read_depth(tmp_path / "a.npy", unit="m"), sparse)
    millimetres = np.rint(sparse * 1000).astype(np.uint16)
    Image.fromarray(millimetres).save(tmp_path / "a.png")
    found = lsdc.read_depth(str(tmp_path / "a.png"), unit=1 / 1000)
    np.testing.assert_allclose(found, millimetres / 1000, rtol=1e-6)
    with pytest.warns(lsdc.FileWarning, match="taken to be in"):
        np.testing.assert_array_equal(lsdc.read_depth(tmp_path / "a.png"), found)


def test_standard_deviations_of_a_map_are_left_out_with_a_word(sparse, tmp_path):
    np.savez(tmp_path / "a.npz", depth=sparse, sigma=np.where(sparse > 0, 0.1, 0).astype(np.float32))
    with pytest.warns(lsdc.FileWarning, match="standard deviations are left out"):
        np.testing.assert_array_equal(lsdc.read_depth(tmp_path / "a.npz", unit="m"), sparse)
    assert lsdc.read_points(tmp_path / "a.npz", (64, 48), unit="m").shape == (192, 4)


def test_tables_and_clouds_are_points_to_complete(scene, tmp_path):
    rows = np.array([[10.5, 20.0, 2.0], [40.0, 7.25, 3.0], [5.0, 5.0, 2.5]])
    (tmp_path / "p.csv").write_text("u,v,depth\n" + "\n".join(",".join(map(str, row)) for row in rows))
    found = lsdc.read_points(tmp_path / "p.csv", (64, 48), unit="m")
    np.testing.assert_allclose(found, rows, rtol=1e-6)
    assert scene.complete(found).report["used"] == 3
    vertices = "0 0 2\n0.1 0 2\n0 0 -1\n"
    header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    (tmp_path / "c.ply").write_text(header + vertices)
    (tmp_path / "c.toml").write_text("fx = 100.0\nfy = 100.0\ncx = 31.5\ncy = 23.5\n")
    with pytest.warns(lsdc.FileWarning, match="1 outside"):
        cloud = lsdc.read_points(tmp_path / "c.ply", (64, 48), camera=tmp_path / "c.toml", unit="m")
    np.testing.assert_allclose(cloud, [[31.5, 23.5, 2], [36.5, 23.5, 2]], rtol=1e-6)
    for camera in (lsdc.Camera((100, 100), (31.5, 23.5)), lsdc.Camera.from_file(tmp_path / "c.toml")):
        with pytest.warns(lsdc.FileWarning, match="1 outside"):
            again = lsdc.read_points(tmp_path / "c.ply", (64, 48), camera=camera, unit="m")
        np.testing.assert_array_equal(again, cloud)
    with pytest.raises(lsdc.ReadError, match="nofile") as caught:
        lsdc.read_points(tmp_path / "c.ply", (64, 48), camera="/nofile", unit="m")
    assert "from_matrix" in caught.value.hint
    wide = lsdc.Camera((100, 100), (31.5, 23.5), size=(64, 30))
    with pytest.raises(lsdc.InputError, match="64x30"):
        lsdc.read_points(tmp_path / "c.ply", (64, 48), camera=wide, unit="m")


def test_points_without_a_deviation_beside_others(scene, tmp_path):
    (tmp_path / "p.csv").write_text("u,v,depth,sigma\n10,20,2.0,0.1\n40,7,3.0,0\n5,5,2.5,0.2\n20,30,2.2,0.1\n")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = lsdc.read_points(tmp_path / "p.csv", (64, 48), unit="m")
    known = ~np.isnan(found[:, 3])
    np.testing.assert_allclose(found[known, 3], np.array([0.1, 0.2, 0.1]), rtol=1e-6)
    assert scene.complete(found).report["without_deviation"] == np.count_nonzero(~known)


def test_distances_along_the_ray(sparse, tmp_path):
    down, across = np.mgrid[:48, :64]
    camera = lsdc.Camera((60, 60), (31.5, 23.5))
    longer = np.sqrt(1 + ((across - 31.5) / 60) ** 2 + ((down - 23.5) / 60) ** 2)
    np.save(tmp_path / "far.npy", (sparse * longer).astype(np.float32))
    np.save(tmp_path / "map.npy", sparse)
    found = lsdc.read_points(tmp_path / "far.npy", (64, 48), camera=camera, unit="m", kind="ray")
    expected = lsdc.read_points(tmp_path / "map.npy", (64, 48), unit="m")
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    with pytest.raises(lsdc.Error):
        lsdc.read_points(tmp_path / "far.npy", (64, 48), unit="m", kind="ray")
    with pytest.raises(lsdc.SettingsError, match="sideways"):
        lsdc.read_points(tmp_path / "far.npy", (64, 48), unit="m", kind="sideways")


def test_remarks_reach_whoever_completes_a_path(scene, sparse, tmp_path):
    np.save(tmp_path / "map.npy", (sparse * 1000).astype(np.uint16))
    with pytest.warns(lsdc.FileWarning, match="map.npy: taken to be in") as caught:
        scene.complete(tmp_path / "map.npy")
    # The warning is at the line of the caller.
    assert caught[0].filename == __file__


@pytest.fixture
def model(tmp_path):
    """A folder of a model with an image of 64x48. The second camera, 0.5 to the right, sees the first point, too."""
    files = {
        "cameras": "1 PINHOLE 64 48 100 100 32 24\n",
        "images": "1 1 0 0 0 0 0 0 1 a/left.png\n32 24 7 37 14 8 60 5 9\n2 1 0 0 0 -0.5 0 0 1 b/right.png\n7 24 7\n",
        "points3D": "7 0 0 2 0 0 0 0.1 1 0 2 0\n8 0.1 0 2 0 0 0 0.5 1 1\n9 0 0 -1 0 0 0 0.5 1 2\n",
    }
    for name, text in files.items():
        (tmp_path / f"{name}.txt").write_text(text)
    return tmp_path


def test_models_of_colmap(model):
    files = {path.name: path.read_bytes() for path in model.iterdir()}
    for found in (lsdc.Colmap(model), lsdc.Colmap("s3://bucket/model", files=files)):
        assert found.images == {"a/left.png": (64, 48), "b/right.png": (64, 48)}
        with pytest.warns(lsdc.FileWarning, match="left.png: points left out: 1 without a usable depth"):
            points = found.points("a/left.png")
        # COLMAP's origin is the corner of the first pixel. A point in one image has no standard deviation.
        np.testing.assert_allclose(points[:, :3], [[31.5, 23.5, 2], [36.5, 13.5, 2]], rtol=1e-6)
        # As a stereo camera with a baseline of 0.5, a focal length of 100 and 0.3 pixels.
        np.testing.assert_allclose(points[:, 3], [2**2 * 2**0.5 * 0.3 / (100 * 0.5), np.nan], rtol=1e-4)
        with pytest.raises(lsdc.InputError, match="no image `b`"):
            found.points("b")
    with pytest.raises(lsdc.ReadError, match="s3://bucket/model/images.txt"):
        lsdc.Colmap("s3://bucket/model", files={**files, "images.txt": b"1 1 0"})
    with pytest.raises(lsdc.ReadError, match="holds no points3D.bin"):
        lsdc.Colmap("here", files={name: files[name] for name in ("cameras.txt", "images.txt")})


def test_images_of_a_model_that_are_larger_or_turned(model):
    model = lsdc.Colmap(model)

    def places(size, exif=1):
        with pytest.warns(lsdc.FileWarning, match="1 without"):
            return model.points("a/left.png", size=size, exif=exif)[:, :2].tolist()

    assert places((128, 96)) == [[63.5, 47.5], [73.5, 27.5]]
    # EXIF 6: the first row is the right side. EXIF 3: rotated by 180 degrees.
    assert places((64, 48), 6) == [[48 - 1 - 23.5, 31.5], [48 - 1 - 13.5, 36.5]]
    assert places((64, 48), 3) == [[63 - 31.5, 47 - 23.5], [63 - 36.5, 47 - 13.5]]
    # The model was made from images that had already been rotated.
    assert places((48, 64), 6) == places((64, 48))
    with pytest.raises(lsdc.InputError, match="64x48 in the model"):
        model.points("a/left.png", size=(50, 50))
    with pytest.raises(lsdc.InputError, match="`exif` is 9"):
        model.points("a/left.png", exif=9)


@pytest.mark.parametrize("lens", ["SIMPLE_PINHOLE", "OPENCV", "OPENCV_FISHEYE"])
def test_models_of_pycolmap(tmp_path, lens):
    pycolmap = pytest.importorskip("pycolmap")
    pycolmap.set_random_seed(0)
    options = pycolmap.SyntheticDatasetOptions()
    options.camera_model_id = getattr(pycolmap.CameraModelId, lens)
    coefficients = {"OPENCV": [0.05, -0.02, 1e-3, -1e-3], "OPENCV_FISHEYE": [0.05, -0.02, 0, 0]}.get(lens, [])
    focal = [1280.0] if lens == "SIMPLE_PINHOLE" else [1280.0, 1280.0]
    options.camera_params = [*focal, 512.0, 384.0, *coefficients]
    theirs = pycolmap.synthesize_dataset(options)
    for form in ("text", "binary"):
        folder = tmp_path / form
        folder.mkdir()
        getattr(theirs, f"write_{form}")(folder)
        ours = lsdc.Colmap(folder)
        assert len(ours.images) == theirs.num_images() > 0
        for image in theirs.images.values():
            seen = [(p.xy, theirs.points3D[p.point3D_id].xyz) for p in image.points2D if p.has_point3D()]
            world = np.array([place for _, place in seen])
            pose = image.cam_from_world().matrix()
            expected = np.column_stack([np.array([place for place, _ in seen]) - 0.5, world @ pose[2, :3] + pose[2, 3]])
            found = ours.points(image.name)[:, :3]
            np.testing.assert_allclose(found, expected, rtol=1e-6)
            # The model has no noise: points are where our cameras project them.
            camera = lsdc.Camera(
                (1280, 1280),
                (511.5, 383.5),
                lens={"SIMPLE_PINHOLE": "pinhole", "OPENCV": "radtan"}.get(lens, "fisheye"),
                coefficients=coefficients,
                rotation=pose[:, :3],
                translation=pose[:, 3],
            )
            np.testing.assert_allclose(camera.project(world), expected, rtol=1e-6, atol=1e-6)


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(lsdc.ReadError, match="nowhere"):
        lsdc.read_depth(tmp_path / "nowhere.npy")
    (tmp_path / "cut.png").write_bytes(b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13))
    with pytest.raises(lsdc.ReadError, match="cut.png"):
        lsdc.read_depth(tmp_path / "cut.png", unit="mm")
    np.save(tmp_path / "a.npy", np.ones((4, 5), np.float32))
    with pytest.raises(lsdc.SettingsError, match="no unit"):
        lsdc.read_depth(tmp_path / "a.npy", unit="furlongs")
