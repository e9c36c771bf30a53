"""Networks on other devices."""

import os
import pickle

import numpy as np
import pytest

import lsdc

SOFTWARE = "wgpu:software"


@pytest.fixture
def on_software(gpus):
    """A completer on the software driver."""
    try:
        return lsdc.Completer("small", device=SOFTWARE)
    except lsdc.SettingsError as error:
        if "LSDC_REQUIRE_GPU" in os.environ:
            raise
        pytest.skip(str(error))


def test_unknown_devices_are_refused(has_gpus):
    for name in ("cuda", "", *(["wgpu:soft"] if has_gpus else [])):
        with pytest.raises(lsdc.SettingsError, match=f"unknown device `{name}`") as error:
            lsdc.Completer("small", device=name)
        assert "cpu" in error.value.hint


def test_without_gpus_the_hint_says_how_to_get_them(has_gpus):
    if has_gpus:
        pytest.skip("the package was built with GPUs")
    with pytest.raises(lsdc.SettingsError, match="built without GPUs") as error:
        lsdc.Completer("small", device="wgpu")
    assert "--features gpu" in error.value.hint


def test_without_a_network_nothing_runs_on_a_gpu(on_software):
    with pytest.raises(lsdc.SettingsError, match="nothing to run"):
        lsdc.Completer("none", device=SOFTWARE)


def test_depths_agree_with_those_of_the_cpu(on_software, image, sparse):
    assert on_software.device == SOFTWARE and "wgpu:software" in repr(on_software)
    expected = on_software.with_device("cpu").complete(image, sparse)
    found = on_software.complete(image, sparse)
    # The affinities cross in half precision.
    assert np.abs(found.depth - expected.depth).max() < 1e-3 * np.ptp(expected.depth)
    np.testing.assert_allclose(found.standard_deviation, expected.standard_deviation, rtol=0.01)
    again = pickle.loads(pickle.dumps(on_software))
    assert again.device == SOFTWARE
    np.testing.assert_array_equal(again.complete(image, sparse).depth, found.depth)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork on this system")
def test_a_gpu_does_not_survive_a_fork(on_software, image):
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            on_software.scene(image)
            os.write(write, b"no error")
        except lsdc.SettingsError as error:
            os.write(write, f"{error}; {error.hint}".encode())
        finally:
            os._exit(0)
    os.close(write)
    os.waitpid(child, 0)
    with os.fdopen(read) as pipe:
        said = pipe.read()
    assert "forked" in said and "spawn" in said
