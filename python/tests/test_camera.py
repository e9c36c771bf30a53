"""Cameras against the closed form of a pinhole, and OpenCV's models."""

import pickle
import re

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import lsdc

FOCAL, CENTER = (100.0, 90.0), (31.5, 23.5)


@pytest.fixture
def points():
    random = np.random.default_rng(0)
    return np.column_stack([random.uniform(-0.3, 0.3, (50, 2)), random.uniform(1, 4, 50)])


def quarter_turn():
    """A quarter turn about the vertical axis."""
    return [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]


def test_a_pinhole(points):
    camera = lsdc.Camera(FOCAL, CENTER)
    expected = points[:, :2] / points[:, 2:] * FOCAL + CENTER
    projected = camera.project(points)
    assert_allclose(projected, np.column_stack([expected, points[:, 2]]), rtol=1e-12)
    assert_allclose(camera.unproject(projected), points, rtol=1e-12)
    assert np.isnan(camera.project([[0, 0, -1.0]])).all()


def test_poses(points):
    camera = lsdc.Camera(FOCAL, CENTER, rotation=quarter_turn(), translation=(0.0, 0.1, 0.5))
    moved = points @ np.array(quarter_turn()).T + (0.0, 0.1, 0.5)
    inside = moved[:, 2] > 0
    expected = lsdc.Camera(FOCAL, CENTER).project(moved)
    assert_allclose(camera.project(points), expected)
    assert_allclose(camera.unproject(expected[inside]), points[inside], atol=1e-12)


def test_lenses(points):
    # The formula from OpenCV's documentation.
    k1, k2 = -0.2, 0.05
    x, y = (points[:, :2] / points[:, 2:]).T
    square = x * x + y * y
    bent = np.column_stack([x, y]) * (1 + k1 * square + k2 * square**2)[:, None] * FOCAL + CENTER
    camera = lsdc.Camera(FOCAL, CENTER, lens="radtan", coefficients=(k1, k2))
    assert_allclose(camera.project(points)[:, :2], bent, rtol=1e-12)
    radius = np.sqrt(square)
    angle = np.arctan(radius)
    seen = angle * (1 + 0.1 * angle**2)
    bent = np.column_stack([x, y]) * (seen / radius)[:, None] * FOCAL + CENTER
    camera = lsdc.Camera(FOCAL, CENTER, lens="fisheye", coefficients=(0.1,))
    assert_allclose(camera.project(points)[:, :2], bent, rtol=1e-12)
    assert_allclose(camera.unproject(camera.project(points)), points, atol=1e-8)


def test_a_depth_map_as_points():
    camera = lsdc.Camera(FOCAL, CENTER)
    depth = np.full((48, 64), 2.0, np.float32)
    depth[3, 4] = 0
    cloud = camera.unproject(depth)
    assert cloud.shape == (48, 64, 3) and np.isnan(cloud[3, 4]).all()
    assert_allclose(cloud[10, 20], [(20 - 31.5) / 100 * 2, (10 - 23.5) / 90 * 2, 2.0])


def test_what_a_camera_sees(completer, image):
    camera = lsdc.Camera(FOCAL, CENTER)
    wall = np.array([[x, y, 2.0] for x in np.linspace(-0.6, 0.6, 12) for y in np.linspace(-0.5, 0.5, 9)])
    behind = [[0.0, 0.0, -1.0], [np.nan, 0.0, 1.0], [5.0, 0.0, 1.0], [*(wall[40, :2] * 2), 4.0]]
    cloud = camera.see(np.vstack([wall, behind]), (64, 48))
    assert (len(cloud), cloud.invalid, cloud.outside, cloud.hidden) == (len(wall), 1, 2, 1)
    off = np.abs(completer.complete(image, cloud.points).depth - 2.0)
    # The image has no content, so the network's result beyond the outermost points is arbitrary.
    assert off.mean() < 0.02 and off[1:47, 2:62].max() < 0.05 and off.max() < 0.2


def test_other_resolutions(points):
    camera = lsdc.Camera(FOCAL, CENTER, lens="radtan", coefficients=(0.1,), translation=(0, 0, 1))
    double = camera.scaled(2, 2)
    assert camera.size is None and lsdc.Camera(FOCAL, CENTER, size=(64, 48)).scaled(2, 2).size == (128, 96)
    assert double.focal == (200, 180) and double.center == (63.5, 47.5)
    # Pixels are areas, so their corners are scaled.
    assert_allclose(double.project(points)[:, :2] + 0.5, (camera.project(points)[:, :2] + 0.5) * 2)
    assert_array_equal(double.project(points)[:, 2], camera.project(points)[:, 2])


@pytest.mark.parametrize(
    "options",
    [
        {"focal": (0, 1)},
        {"focal": (np.nan, 1)},
        {"lens": "telescope"},
        {"coefficients": (1,)},
        {"lens": "fisheye", "coefficients": (0,) * 5},
        {"rotation": np.diag([1, 1, -1])},
        {"rotation": np.eye(3) * 2},
        {"translation": (np.inf, 0, 0)},
    ],
)
def test_cameras_that_cannot_be(options):
    with pytest.raises(lsdc.SettingsError):
        lsdc.Camera(**{"focal": FOCAL, "center": CENTER, **options})


MATRIX = [[500.0, 0.0, 319.5], [0.0, 510.0, 239.5], [0.0, 0.0, 1.0]]


def test_matrices_of_opencv_open3d_and_ros():
    for matrix in (MATRIX, np.array(MATRIX), np.ravel(MATRIX), np.array(MATRIX, np.float32)):
        camera = lsdc.Camera.from_matrix(matrix, (640, 480))
        assert (camera.focal, camera.center, camera.size) == ((500, 510), (319.5, 239.5), (640, 480))
        assert camera.lens == "pinhole"


def test_lenses_of_opencv_and_ros(points):
    five = [-0.2, 0.05, 1e-3, -2e-3, 0.01]
    expected = lsdc.Camera((500, 510), (319.5, 239.5), lens="radtan", coefficients=five).project(points)
    # cv2.calibrateCamera gives (1, 5), or 12 and 14 coefficients including unsupported ones.
    forms = (five, np.array([five]), np.array(five)[:, None], [*five, 0, 0, 0, 0, 0, 0, 0], [*five, *[0] * 9])
    for model in (None, "radtan", "plumb_bob", "rational_polynomial"):
        for form in forms:
            camera = lsdc.Camera.from_matrix(MATRIX, (640, 480), form, model=model)
            assert_allclose(camera.project(points), expected, rtol=1e-12)
    four = [0.1, -0.02, 0.003, 0.0]
    expected = lsdc.Camera((500, 510), (319.5, 239.5), lens="fisheye", coefficients=four).project(points)
    for model in ("fisheye", "equidistant"):
        camera = lsdc.Camera.from_matrix(MATRIX, (640, 480), np.array(four)[:, None], model=model)
        assert_allclose(camera.project(points), expected, rtol=1e-12)
    assert lsdc.Camera.from_matrix(MATRIX, (640, 480), np.zeros(5)).lens == "pinhole"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"matrix": np.transpose(MATRIX)}, "transposed"),
        ({"matrix": np.eye(4)}, ""),
        ({"matrix": np.diag([500, 500, 2.0])}, r"\[0, 0, 1\]"),
        ({"matrix": [[500, 3, 320], [0, 500, 240], [0, 0, 1]]}, "undistort"),
        ({"matrix": "K"}, ""),
        ({"matrix": [["a"] * 3] * 3}, ""),
        ({"size": 640}, ""),
        ({"size": (0, 480)}, ""),
        ({"distortion": [0.1] * 14}, "lenses"),
        ({"distortion": [0.1] * 5, "model": "fisheye"}, "lenses"),
        ({"distortion": [0.1], "model": "pinhole"}, "lenses"),
        ({"distortion": ["a"]}, ""),
        ({"model": "telescope"}, "plumb_bob"),
    ],
)
def test_matrices_that_cannot_be(arguments, words):
    with pytest.raises(lsdc.Error) as caught:
        lsdc.Camera.from_matrix(**{"matrix": MATRIX, "size": (640, 480), **arguments})
    assert re.search(words, caught.value.hint or "")


def test_cameras_in_files(tmp_path, points):
    (tmp_path / "c.toml").write_text(
        "width = 640\nheight = 480\nfx = 500.0\nfy = 510.0\ncx = 319.5\ncy = 239.5\nmodel = 'radtan'\n"
        "distortion = [-0.2, 0.05, 0.001, -0.002]\nworld_to_camera = [[0, 0, 1, 0], [0, 1, 0, 0.1], [-1, 0, 0, 0.5]]\n"
    )
    camera = lsdc.Camera.from_file(tmp_path / "c.toml")
    expected = lsdc.Camera.from_matrix(
        MATRIX, (640, 480), [-0.2, 0.05, 1e-3, -2e-3], rotation=quarter_turn(), translation=(0, 0.1, 0.5)
    )
    assert camera.size == (640, 480) and camera.lens == "radtan"
    assert_array_equal(camera.project(points), expected.project(points))
    again = pickle.loads(pickle.dumps(camera))
    assert repr(again) == repr(camera)
    assert_array_equal(again.project(points), camera.project(points))
    with pytest.raises(lsdc.ReadError, match="nowhere") as caught:
        lsdc.Camera.from_file(tmp_path / "nowhere.toml")
    assert caught.value.hint
    (tmp_path / "d.toml").write_text("fx = 'wide'")
    with pytest.raises(lsdc.ReadError, match="d.toml") as caught:
        lsdc.Camera.from_file(str(tmp_path / "d.toml"))
    assert caught.value.hint


@pytest.mark.parametrize(
    "options",
    [{"coefficients": "ab"}, {"rotation": [["a"] * 3] * 3}, {"translation": None, "lens": 5}, {"center": "ab"}, {"size": 4}],
)
def test_every_refusal_is_an_error_of_the_package(options):
    with pytest.raises(lsdc.Error):
        lsdc.Camera(**{"focal": FOCAL, "center": CENTER, **options})


@pytest.mark.parametrize(
    "options", [{"focal": 5}, {"focal": (1, 2, 3)}, {"rotation": np.eye(2)}, {"translation": [0, 0]}]
)
def test_numbers_of_another_shape(options):
    with pytest.raises(lsdc.InputError):
        lsdc.Camera(**{"focal": FOCAL, "center": CENTER, **options})
