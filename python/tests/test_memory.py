"""Many calls need no more memory than a few.

`LSDC_CALLS` is the number of calls: 2,000 by default, 100,000 before a release.
"""

import os
import sys
from pathlib import Path

import numpy as np
import pytest

import lsdc

CALLS = int(os.environ.get("LSDC_CALLS", "2000"))
MEGABYTE = 1 << 20

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")


def resident() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


@pytest.fixture(scope="module")
def tiny():
    """A small image and points, which take little time."""
    completer = lsdc.Completer("small", fit={"method": "lse"}, working_size=(16, 12), threads=1)
    image = np.arange(12 * 16 * 3, dtype=np.uint8).reshape(12, 16, 3)
    return completer, image


def grown(call, count):
    """Returns the growth of memory in bytes over `count` calls, after a tenth as many."""
    for _ in range(max(count // 10, 50)):
        call()
    before = resident()
    for _ in range(count):
        call()
    return resident() - before


def test_completions(tiny):
    completer, image = tiny
    points = np.array([[3.0, 3.0, 2.0], [9.0, 8.0, 2.5], [12.0, 2.0, 2.2]])

    def call():
        completion = completer.complete(image, points)
        completion.depth, completion.residuals, completion.outliers, completion.report, completion.points

    assert grown(call, CALLS) < 4 * MEGABYTE


def test_errors(tiny):
    completer, image = tiny
    scene = completer.scene(image)

    def call():
        for wrong in (np.zeros((12, 16)), np.zeros((5, 5)), None):
            with pytest.raises(lsdc.Error):
                scene.complete(wrong)

    assert grown(call, CALLS) < 4 * MEGABYTE


def test_arguments(tiny):
    completer, image = tiny
    scene = completer.scene(image)
    sparse = np.full((12, 16), 2.0, np.float64)[::-1]

    def call():
        scene.complete(sparse, sigma=sparse / 9, unit="mm")
        lsdc.DepthGuide(sparse * np.arange(16))
        lsdc.Camera((9, 9), (8, 6)).see(np.ones((50, 3)), (16, 12))

    assert grown(call, CALLS // 4) < 4 * MEGABYTE


def test_completers():
    weights = (Path(__file__).parents[2] / "crates/core/weights/small.safetensors").read_bytes()
    assert grown(lambda: lsdc.Completer(weights, threads=1), max(CALLS // 100, 20)) < 8 * MEGABYTE
