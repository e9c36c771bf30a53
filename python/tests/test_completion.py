"""Results of a completion."""

import json
import struct
import zlib

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import lsdc


@pytest.fixture(scope="module")
def completion(scene, sparse):
    return scene.complete(sparse)


# Pixels between the outermost points. The image has no content, so the network's result beyond them is arbitrary.
BETWEEN = np.s_[2:47, 2:63]


def plane(sparse):
    """The true depth from which the sparse depths were sampled."""
    return 1.5 + np.mgrid[:48, :64][1] / 64.0


def test_depth_is_that_of_the_plane(completion, sparse):
    assert completion.depth.dtype == np.float32 and completion.depth.shape == (48, 64)
    off = np.abs(completion.depth - plane(sparse))
    assert off.mean() < 0.02 and off[BETWEEN].max() < 0.05
    assert (off < plane(sparse) / 10).all()
    assert (completion.standard_deviation > 0).all()


def test_results_are_computed_once_and_cannot_be_written_to(completion):
    names = [
        "depth",
        "standard_deviation",
        "points",
        "residuals",
        "leave_one_out",
        "point_weights",
        "weights",
    ]
    for name in names:
        first = getattr(completion, name)
        assert getattr(completion, name) is first
        with pytest.raises(ValueError, match="read-only"):
            first[...] = 0
    assert completion.outliers is completion.outliers
    # Maps computed at another size belong to the caller.
    completion.depth_at((64, 48))[...] = 0
    assert (completion.depth > 0).all()


def test_residuals_are_depths_minus_the_map(completion, sparse):
    at_points = completion.depth[sparse > 0]
    assert_allclose(completion.residuals, completion.points[:, 2] - at_points, atol=1e-5)
    root_mean_square = np.sqrt(np.mean(completion.residuals**2))
    assert_allclose(completion.report["residual"], root_mean_square, rtol=1e-9)
    assert_allclose(completion.at(completion.points[:, :2]), at_points, atol=1e-5)


def test_leaving_one_out_is_leaving_it_out(scene, sparse):
    # With a fixed strength of the prior, the closed form is exact.
    random = np.random.default_rng(1)
    completer = lsdc.Completer("small", fit={"method": "lse", "lambda": 0.1})
    scene = completer.scene(random.integers(0, 255, (48, 64, 3), np.uint8))
    points = scene.complete(sparse).points[::4].copy()
    points[:, 2] += random.normal(0, 0.1, len(points))
    completion = scene.complete(points)
    squares = completion.leave_one_out[np.isfinite(completion.leave_one_out)] ** 2
    assert_allclose(completion.leave_one_out_error, np.sqrt(squares.mean()))
    # The prior is scaled by the mean depth, which changes slightly.
    for i in (0, 7, 20):
        others = scene.complete(np.delete(points, i, axis=0))
        error = points[i, 2] - others.at(points[i, :2])[0]
        assert_allclose(completion.leave_one_out[i], error, rtol=0.02, atol=2e-3)


def test_sizes(scene, sparse, completion):
    large = scene.complete(sparse, size=(128, 96))
    assert large.size == (128, 96) and large.depth.shape == large.standard_deviation.shape == (96, 128)
    assert_array_equal(large.depth, completion.depth_at((128, 96)))
    assert_array_equal(large.standard_deviation, completion.standard_deviation_at((128, 96)))
    assert completion.depth_at((1, 1)).shape == (1, 1)
    for size in [(0, 5), (5, -1), (1 << 20, 1 << 20), 5, "64x48", (1, 2, 3), None]:
        with pytest.raises(lsdc.InputError):
            completion.depth_at(size)


def test_robust_fits_and_outliers(scene, sparse):
    wrong = sparse.copy()
    places = [(10, 10), (26, 42), (42, 58)]
    for v, u in places:
        wrong[v, u] *= 2
    plain, robust = scene.complete(wrong), scene.complete(wrong, robust="auto")
    truth = plane(sparse)
    assert np.abs(robust.depth - truth).mean() < 0.2 * np.abs(plain.depth - truth).mean()
    found = robust.outliers
    assert len(found) == 3 and (found.probability > 0.5).all() and (found.error > 0).all()
    assert sorted(map(tuple, robust.points[found.index, 1::-1])) == sorted(places)
    assert (robust.point_weights[found.index] < 0.1).all()
    assert (plain.point_weights == 1).all()
    assert_array_equal(found.weight, robust.point_weights[found.index])
    # Robustness as settings, and set in the completer.
    cauchy = scene.complete(wrong, robust={"loss": "cauchy", "iterations": 5})
    assert np.abs(cauchy.depth - truth).mean() < np.abs(plain.depth - truth).mean()
    for other in (lsdc.Completer("small", robust="auto"), lsdc.Completer("small", fit={"robust": "auto"})):
        assert other.fit["robust"]["loss"] == "auto"
        image = np.zeros((48, 64, 3), np.uint8)
        assert (other.complete(image, wrong).point_weights < 0.5).any()


def test_guides(completer, image):
    # A floor that rises to a wall, and a box in front, with depths at scattered pixels.
    v, u = np.mgrid[:48, :64]
    truth = 4 - 0.05 * np.maximum(v - 20, 0)
    truth[22:40, 20:40] = 1.5
    x, y = 37 * np.arange(40) % 64, 29 * np.arange(40) % 48
    points = np.column_stack([x, y, truth[y, x]])
    plain = completer.complete(image, points)
    guide = lsdc.DepthGuide(1 / truth + 3, kind="disparity")
    guided = completer.complete(image, points, guide=guide)
    assert plain.report["guide_trust"] is None and guided.report["guide_trust"] > 0
    assert np.abs(guided.depth - truth).mean() < np.abs(plain.depth - truth).mean()
    # A guide for one fit, or for all fits of a scene.
    scene = completer.scene(image)
    assert_array_equal(scene.complete(points, guide=guide).depth, guided.depth)
    assert_array_equal(completer.scene(image, guide=guide).complete(points).depth, guided.depth)
    # An array is a guide of depths, of any size and unit.
    assert not completer.has_depth_head
    assert_array_equal(completer.complete(image, points, guide="none").depth, plain.depth)
    with pytest.raises(lsdc.InputError, match='neither a map nor "none"'):
        completer.complete(image, points, guide="nothing")
    half = completer.complete(image, points, guide=100 * truth[::2, ::2])
    assert half.report["guide_trust"] > 0
    alone = lsdc.Completer("none").complete(image, points, guide=truth)
    assert np.abs(alone.depth - truth).mean() < np.abs(plain.depth - truth).mean()
    with pytest.raises(lsdc.SettingsError, match="depths"):
        lsdc.DepthGuide(truth, kind="depths")
    for wrong in (np.zeros((4, 4)), np.ones(4), np.full((2, 2), np.nan), np.zeros((0, 3))):
        with pytest.raises(lsdc.InputError):
            lsdc.DepthGuide(wrong)


def test_the_next_frame_of_a_video(scene, sparse, completion):
    near = scene.complete(sparse, near=completion)
    assert_array_equal(scene.complete(sparse, near=completion.weights).depth, near.depth)
    off = np.abs(near.depth - completion.depth)
    assert off[BETWEEN].max() < 0.05 and (off < completion.depth / 10).all()
    with pytest.raises(lsdc.FitError) as caught:
        scene.complete(sparse, near=np.ones(3))
    assert "Completion.weights" in caught.value.hint


def test_intervals(completion):
    assert_allclose(completion.interval(0.682689), 1.0, rtol=1e-3)
    assert completion.interval(0.95) > completion.interval(0.9) > 1
    assert completion.freedom is None or completion.freedom > 0
    # Depth Anything predicted no guide.
    assert completion.sky_pixels == 0
    for level in (0, 1, 2, float("nan")):
        with pytest.raises(lsdc.SettingsError):
            completion.interval(level)


def test_limits(completion, sparse):
    given = sparse[sparse > 0]
    assert_allclose(completion.limits, (given.min() / 10, given.max() * 10), rtol=1e-6)


def test_basis_functions(scene):
    functions = scene.basis_functions([[0, 0], [31.5, 20.25]])
    # The first function is the constant 1, or the depth predicted from the image.
    assert functions.shape[0] == 2 and (functions[:, 0] > 0).all()
    assert scene.basis_functions(np.zeros((0, 2))).shape[0] == 0
    with pytest.raises(lsdc.InputError):
        scene.basis_functions(np.zeros((5, 3)))


def test_places_outside_are_refused(completion):
    assert completion.at([5, 5]).shape == (1,)
    with pytest.raises(lsdc.FitError, match="not in the image"):
        completion.at([[64.0, 3.0]])


def test_the_report_is_plain_data(completion, sparse):
    report = json.loads(json.dumps(completion.report))
    assert report["given"] == report["used"] + report["invalid"] + report["outside"] == (sparse > 0).sum()
    assert report["method"] == "joint" and report["functions"] > 1
    assert report["fit"] >= report["field"] >= 0


def test_one_point_has_no_deviation_with_basis_functions_alone(image):
    completer = lsdc.Completer("small", fit={"method": "lse", "prior": "none"})
    with pytest.raises(lsdc.FitError):
        completer.complete(image, [[5, 5, 2.0]]).standard_deviation


def test_pictures(completion):
    picture = completion._repr_png_()
    assert picture.startswith(b"\x89PNG") and struct.unpack(">II", picture[16:24]) == (64, 48)
    start = picture.index(b"IDAT")
    length = struct.unpack(">I", picture[start - 4 : start])[0]
    rows = zlib.decompress(picture[start + 4 : start + 4 + length])
    assert len(rows) == 48 * (1 + 3 * 64)


def test_names(completer, scene, completion):
    assert repr(completer) == "lsdc.Completer('small')" and repr(scene) == "<lsdc.Scene 64x48>"
    assert repr(completion).startswith("<lsdc.Completion 64x48, 192 points")
    assert repr(lsdc.Completer("small", threads=2, fit={"ridge": 1}, working_size=(32, 24))) == (
        "lsdc.Completer('small', fit={'ridge': 1}, working_size=(32, 24), threads=2)"
    )


def test_the_report_tells_how_far_the_map_is_from_the_joint_fit(completion, scene, sparse):
    assert 0 <= completion.report["median_share"] <= 1
    # A single point spans no surface.
    sparse = np.zeros_like(sparse)
    sparse[20, 30] = 2
    assert scene.complete(sparse).report["median_share"] is None


def test_alignment_pools_evidence_of_a_shift(completer):
    """Points of three flat surfaces, unshifted and shifted by 8 pixels."""
    random = np.random.default_rng(3)
    image = np.full((228, 304, 3), 60, np.uint8)
    image[:, 152:] = 180
    image[60:170, 40:110] = 120
    depth = np.full((228, 304), 3.0)
    depth[:, 152:] = 2.0
    depth[60:170, 40:110] = 1.2
    x, y = random.integers(30, 270, 2000), random.integers(30, 200, 2000)
    scene = completer.scene(image)
    right = scene.alignment(np.column_stack([x, y, depth[y, x]]))
    moved = scene.alignment(np.column_stack([x, y, depth[y, x + 8]]))
    assert right.points == 2000 and (right + moved).points == 4000
    assert not right.shift.is_clear
    assert abs(moved.shift.u - 8) < 5 and moved.shift.error_moved < moved.shift.error
    assert (moved + moved).shift.frames == 2
    assert "(+8, +0) pixels" in str(moved.shift)
    none = scene.alignment(np.column_stack([x, y, depth[y, x]])[:50])
    assert none.points == 0 and none.shift is None and lsdc.Alignment().shift is None
