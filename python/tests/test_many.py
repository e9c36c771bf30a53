"""Many images give the results of single completions, in order."""

import threading

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import lsdc


@pytest.fixture(scope="module")
def points(sparse):
    return [sparse * factor for factor in (1, 2, 3, 4, 5)]


def test_the_same_as_one_by_one(completer, image, points):
    for workers in (1, 2, 4):
        found = list(completer.complete_many([image] * 5, points, workers=workers))
        assert [done.index for done in found] == [0, 1, 2, 3, 4]
        for done, known in zip(found, points, strict=True):
            assert done.error is None
            assert_array_equal(done.result().depth, completer.complete(image, known).depth)


def test_options_reach_every_image(completer, image, points):
    guide = np.linspace(1, 2, 48 * 64).reshape(48, 64)
    options = {"sigma": 0.05, "robust": "auto", "size": (32, 24)}
    (done,) = lsdc.complete_many([image], [points[0]], guides=[guide], weights="small", **options)
    expected = completer.scene(image, guide=guide).complete(points[0], **options)
    assert_array_equal(done.result().depth, expected.depth)
    (done,) = completer.complete_many([image[..., ::-1].copy()], [points[0] * 1000], unit="mm", order="bgr")
    expected = completer.complete(image, points[0] * 1000, unit="mm")
    assert_array_equal(done.result().depth, expected.depth)


def test_errors_stop_no_other_image(completer, image, points, tmp_path):
    images = [image, tmp_path / "missing.png", image, image]
    known = [points[0], points[1], points[2] * 0, points[3]]
    found = list(completer.complete_many(images, known))
    assert [type(done.error) for done in found] == [type(None), lsdc.ReadError, lsdc.FitError, type(None)]
    assert found[1].completion is None and "missing.png" in str(found[1].error)
    with pytest.raises(lsdc.FitError):
        found[2].result()
    assert_array_equal(found[3].result().depth, completer.complete(image, points[3]).depth)


def test_few_images_are_in_memory(completer, image, sparse):
    drawn = []

    def images():
        for number in range(20):
            drawn.append(number)
            yield image

    for done in completer.complete_many(images(), (sparse for _ in range(20)), workers=2):
        assert len(drawn) <= done.index + 4
    assert len(drawn) == 20


def test_progress(completer, image, points):
    told = []
    list(completer.complete_many([image] * 5, points, progress=lambda *counts: told.append(counts)))
    assert told == [(i, 5) for i in (1, 2, 3, 4, 5)]
    told.clear()
    list(completer.complete_many(iter([image] * 2), iter(points[:2]), progress=lambda *counts: told.append(counts)))
    assert told == [(1, None), (2, None)]


def test_whoever_stops_early_leaves_no_thread(completer, image, points):
    results = completer.complete_many([image] * 5, points)
    next(results)
    results.close()
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("lsdc")]


def test_as_many_points_as_images(completer, image, points):
    for images in ([image] * 3, [image] * 6, iter([image] * 3)):
        found = []
        with pytest.raises(lsdc.InputError, match="as many|more of the other"):
            found.extend(completer.complete_many(images, points))
    results, found = completer.complete_many([image] * 3, points), []
    with pytest.raises(lsdc.InputError):
        for done in results:
            found.append(done.index)
    assert found == [0, 1, 2]
    with pytest.raises(lsdc.SettingsError, match="workers"):
        completer.complete_many([image], points, workers=0)
