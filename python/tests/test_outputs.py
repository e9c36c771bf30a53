"""Outputs of networks that other programs run."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import lsdc

LSE = {"method": "lse"}


@pytest.fixture(scope="module")
def at_image_size():
    return lsdc.Completer("small", fit=LSE, working_size=(64, 48))


@pytest.fixture(scope="module")
def outputs(at_image_size, image):
    """The network's own basis functions, with constant affinities, which this fit does not use."""
    y, x = np.mgrid[:48, :64]
    functions = at_image_size.scene(image).basis_functions(np.stack([x.ravel(), y.ravel()], axis=-1))
    return functions.T.reshape(1, -1, 48, 64), np.ones((1, 2, 48, 64), np.float32)


def test_the_input_is_the_resized_image(completer, image):
    alike = lsdc.Completer("small", working_size=(64, 48)).network_input(image)
    assert alike.dtype == np.float32
    assert_array_equal(alike[0], (image / np.float32(255)).transpose(2, 0, 1))
    swapped = lsdc.Completer("small", working_size=(64, 48)).network_input(image[:, :, ::-1].copy(), order="bgr")
    assert_array_equal(alike, swapped)
    assert completer.network_input(image).shape == (1, 3, 228, 304)


def test_the_same_outputs_give_the_same_depths(at_image_size, image, sparse, outputs):
    expected = at_image_size.complete(image, sparse)
    for given in (outputs, [values[0].astype(np.float64) for values in outputs]):
        found = at_image_size.scene(image, outputs=given).complete(sparse)
        assert_allclose(found.depth, expected.depth, rtol=1e-4)
        assert_allclose(found.standard_deviation, expected.standard_deviation, rtol=1e-3)


def test_outputs_that_cannot_be_used(at_image_size, image, outputs):
    basis, affinities = outputs
    for wrong, words in [
        ((basis,), "pair"),
        ((basis[0, 0], affinities), "basis functions"),
        ((basis.astype(np.int32), affinities), "int32"),
        ((basis, affinities[:, :1]), "affinities"),
        ((basis, affinities[:, :, 1:]), "affinities"),
    ]:
        with pytest.raises(lsdc.InputError, match=words):
            at_image_size.scene(image, outputs=wrong)
    with pytest.raises(lsdc.Error, match="64 basis functions"):
        at_image_size.scene(image, outputs=(basis[:, 1:], affinities))
    with pytest.raises(lsdc.Error, match="not finite"):
        at_image_size.scene(image, outputs=(basis * np.nan, affinities))
