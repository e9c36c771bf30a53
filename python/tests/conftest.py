"""Images and depths for tests, and for the examples in docstrings."""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import lsdc
from lsdc._native import check_device

# The tests of clusters need Ray.
collect_ignore = [] if find_spec("ray") and find_spec("pyarrow") else ["cluster"]

ROOM = Path(__file__).parents[2] / "assets/room"


@pytest.fixture(scope="session")
def has_gpus():
    """Whether the package was built with GPUs."""
    try:
        check_device("wgpu")
    except lsdc.SettingsError:
        return False
    return True


@pytest.fixture(scope="session")
def gpus(has_gpus):
    """Skips tests that need a package with GPUs."""
    if not has_gpus:
        pytest.skip("the package was built without GPUs")


@pytest.fixture(scope="session")
def image():
    """An image of 64x48 pixels with gradients."""
    down, across = np.mgrid[:48, :64]
    return np.stack([across * 3, down * 4, across + down], axis=-1).astype(np.uint8)


@pytest.fixture(scope="session")
def sparse():
    """The depths of every fourth pixel of a slanted plane, from 1.5 to 2.5 m."""
    across = np.mgrid[:48, :64][1]
    sparse = np.zeros((48, 64), np.float32)
    sparse[2::4, 2::4] = (1.5 + across / 64.0)[2::4, 2::4]
    return sparse


@pytest.fixture(scope="session")
def completer():
    return lsdc.Completer("small")


@pytest.fixture(scope="session")
def scene(completer, image):
    return completer.scene(image)


@pytest.fixture
def names(image, sparse):
    """Names that examples use."""
    return {"np": np, "lsdc": lsdc, "image": image, "sparse": sparse.copy()}
