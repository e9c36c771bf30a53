"""Point clouds of completions."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import lsdc

CAMERA = lsdc.Camera((60, 55), (31.5, 23.5), size=(64, 48))


@pytest.fixture(scope="module")
def completion(scene, sparse):
    return scene.complete(sparse)


@pytest.fixture(scope="module")
def edge(image):
    """A wall at 1 m beside one at 3 m, in an image that shows nothing of it."""
    sparse = np.zeros((48, 64), np.float32)
    sparse[2::4, 2:30:4] = 1
    sparse[2::4, 34::4] = 3
    return lsdc.Completer("small").complete(np.full_like(image, 90), sparse)


def test_points_colours_and_deviations(completion, image):
    cloud = completion.point_cloud(CAMERA)
    assert (cloud.uncertain, cloud.unseen, cloud.flying, cloud.merged) == (0, 0, 0, 0)
    assert cloud.points.dtype == np.float32 and cloud.colors.dtype == np.uint8
    assert_allclose(cloud.points.reshape(48, 64, 3), CAMERA.unproject(completion.depth), rtol=1e-6, atol=1e-6)
    assert_array_equal(cloud.colors, image.reshape(-1, 3))
    assert_array_equal(cloud.sigma, completion.standard_deviation.ravel())
    assert len(cloud) == 48 * 64
    # The camera adapts to another size of the same view.
    assert len(completion.point_cloud(CAMERA, size=(32, 24))) == 32 * 24


def test_colours_are_those_that_were_given(completer, image, sparse):
    expected = image.reshape(-1, 3)
    own = image.copy()
    forms = (own, np.ascontiguousarray(image[..., ::-1])), ("rgb", "bgr")
    for form, order in zip(*forms, strict=True):
        completion = completer.complete(form, sparse, order=order)
        form[:] = 0
        assert_array_equal(completion.point_cloud(CAMERA).colors, expected)
    grey = completer.complete(image[..., 0] / np.float32(255), sparse).point_cloud(CAMERA)
    assert_array_equal(grey.colors, np.repeat(image[..., 0].reshape(-1, 1), 3, axis=1))


def test_uncertain_pixels_are_left_out(completion):
    most = float(np.median(completion.standard_deviation))
    cloud = completion.point_cloud(CAMERA, max_sigma=most)
    assert cloud.uncertain == np.count_nonzero(completion.standard_deviation > np.float32(most)) > 0
    assert len(cloud) == 48 * 64 - cloud.uncertain
    assert cloud.sigma.max() <= np.float32(most)


def test_one_point_in_each_voxel(completion):
    whole = completion.point_cloud(CAMERA)
    cloud = completion.point_cloud(CAMERA, voxel=0.2)
    cubes = np.unique(np.floor(whole.points.astype(float) / 0.2), axis=0)
    assert len(cloud) == len(cubes) and cloud.merged == len(whole) - len(cloud)
    assert_array_equal(np.unique(np.floor(cloud.points.astype(float) / 0.2), axis=0), cubes)


def test_flying_pixels_are_left_out(edge):
    camera = lsdc.Camera((200, 200), (31.5, 23.5))
    every = {"max_relative_sigma": 1e6}  # uncertain pixels, too
    whole, cloud = edge.point_cloud(camera, keep_flying=True, **every), edge.point_cloud(camera, **every)
    assert len(whole) == 48 * 64 and cloud.flying == len(whole) - len(cloud) > 0

    def between(points):
        return np.count_nonzero((points[:, 2] > 1.3) & (points[:, 2] < 2.7))

    assert between(cloud.points) < 0.2 * between(whole.points)
    # Pixels far from the edge are kept.
    assert np.count_nonzero(cloud.points[:, 2] < 1.1) > 0.95 * np.count_nonzero(whole.points[:, 2] < 1.1)


def test_too_few_points_for_deviations(scene):
    completion = scene.complete([[10.0, 10.0, 2.0]])
    try:
        completion.standard_deviation
    except lsdc.FitError:
        assert completion.point_cloud(CAMERA).sigma is None
        with pytest.raises(lsdc.FitError):
            completion.point_cloud(CAMERA, max_sigma=0.1)


def test_far_from_the_origin_coordinates_are_doubles(completion):
    far = lsdc.Camera((60, 55), (31.5, 23.5), translation=(-4e5, -5e6, 0))
    cloud = completion.point_cloud(far)
    assert cloud.points.dtype == np.float64
    near = completion.point_cloud(lsdc.Camera((60, 55), (31.5, 23.5)))
    assert_allclose(cloud.points - (4e5, 5e6, 0), near.points, atol=1e-6)


def test_what_cannot_be(completion):
    with pytest.raises(lsdc.InputError, match="640x300"):
        completion.point_cloud(lsdc.Camera((60, 55), (320, 150), size=(640, 300)))
    for camera in ("camera.toml", np.eye(3), None):
        with pytest.raises(lsdc.InputError, match="not a lsdc.Camera") as caught:
            completion.point_cloud(camera)
        assert "from_file" in caught.value.hint
    for options in ({"max_sigma": 0}, {"voxel": -1}, {"voxel": np.nan}, {"max_sigma": np.inf}):
        with pytest.raises(lsdc.SettingsError):
            completion.point_cloud(CAMERA, **options)


def test_open3d_takes_it_in_two_lines(completion):
    o3d = pytest.importorskip("open3d")
    cloud = completion.point_cloud(CAMERA)
    shown = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud.points))
    shown.colors = o3d.utility.Vector3dVector(cloud.colors / 255)
    assert_allclose(np.asarray(shown.points), cloud.points)
