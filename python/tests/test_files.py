"""Files: what is read is what other programs wrote, and what is guessed is said."""

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
    found = lsdc.read_depth(str(tmp_path / "a.png"), unit=1000)
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


def test_models_of_colmap(tmp_path):
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 64 48 100 100 32 24\n")
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a/left.png\n32 24 7 37 24 8\n")
    points = "7 0 0 2 0 0 0 0.5 1 0\n8 0.1 0 2 0 0 0 0.5 1 1\n"
    (tmp_path / "points3D.txt").write_text(points)
    model = lsdc.Colmap(tmp_path)
    assert model.images == {"a/left.png": (64, 48)}
    # COLMAP counts from the corner of the first pixel.
    found = model.points("a/left.png")
    np.testing.assert_allclose(found[:, :3], [[31.5, 23.5, 2], [36.5, 23.5, 2]], rtol=1e-6)
    with pytest.raises(lsdc.InputError, match="no image `b`"):
        model.points("b")


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(lsdc.ReadError, match="nowhere"):
        lsdc.read_depth(tmp_path / "nowhere.npy")
    (tmp_path / "cut.png").write_bytes(b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13))
    with pytest.raises(lsdc.ReadError, match="cut.png"):
        lsdc.read_depth(tmp_path / "cut.png", unit="mm")
    np.save(tmp_path / "a.npy", np.ones((4, 5), np.float32))
    with pytest.raises(lsdc.SettingsError, match="no unit"):
        lsdc.read_depth(tmp_path / "a.npy", unit="furlongs")
