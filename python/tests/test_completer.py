"""Weights and settings."""

import copy
import multiprocessing
import os
import pickle
import subprocess
import sys
import threading
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import lsdc

ROOT = Path(__file__).parents[2]
SMALL = ROOT / "crates/core/weights/small.safetensors"
ENCODED = ROOT / "crates/weights/weights/anything.safetensors"


def completed(completer, image, sparse):
    """A function at module level, for other processes."""
    return completer.complete(image, sparse).depth


def test_weights_by_name_path_and_bytes(completer, image, sparse):
    expected = completed(completer, image, sparse)
    for weights in ("small", SMALL, str(SMALL), SMALL.read_bytes()):
        assert_array_equal(completed(lsdc.Completer(weights), image, sparse), expected)
        assert_array_equal(lsdc.complete(image, sparse, weights=weights), expected)
    assert lsdc.Completer().parameters > completer.parameters > 100_000
    assert lsdc.Completer("none").parameters == 0
    assert (lsdc.complete(image, sparse) != expected).any()


def test_damaged_weights(tmp_path):
    whole = SMALL.read_bytes()
    for damaged in (b"", b"weights", whole[:1000], whole[:-1], bytes(1000)):
        with pytest.raises(lsdc.WeightsError):
            lsdc.Completer(damaged)
    with pytest.raises(lsdc.ReadError, match="missing") as caught:
        lsdc.Completer(tmp_path / "missing.safetensors")
    assert isinstance(caught.value, OSError) and caught.value.hint
    with pytest.raises(lsdc.ReadError):
        lsdc.Completer(tmp_path)
    with pytest.raises(lsdc.WeightsError, match="huge"):
        lsdc.Completer("huge")


def test_weights_on_an_encoder_that_is_not_installed(monkeypatch, tmp_path):
    monkeypatch.setenv("LSDC_WEIGHTS", str(tmp_path / "nowhere"))
    # In another process: this one remembers where it found the encoder.
    code = "import lsdc, sys; lsdc.Completer(sys.argv[1])"
    for weights in ("anything", str(ENCODED)):
        failed = subprocess.run([sys.executable, "-c", code, weights], capture_output=True, text=True, cwd=tmp_path)
        for words in ("ReadError", "Depth Anything V2 Small", "nowhere", "lsdc weights get anything", "lsdc weights add FILE"):
            assert words in failed.stderr or (words.startswith("lsdc weights") and sys.version_info < (3, 11))


def test_weights_on_an_encoder_that_is_installed(image, sparse):
    try:
        own = lsdc.Completer("anything")
    except lsdc.ReadError as error:
        pytest.skip(str(error))
    found = completed(own, image, sparse)
    assert_array_equal(completed(lsdc.Completer(ENCODED), image, sparse), found)
    assert_array_equal(lsdc.complete(image, sparse, weights="anything"), found)
    assert_array_equal(completed(pickle.loads(pickle.dumps(own)), image, sparse), found)
    # Many calls at once, on one pool.
    with ThreadPoolExecutor(8) as threads:
        made = list(threads.map(lambda _: lsdc.Completer("anything"), range(8)))
    assert_array_equal(completed(made[-1], image, sparse), found)


def test_the_size_that_an_encoder_reads(image, sparse):
    for side, error in ((600, "not 252 to 518"), (-1, "not 252 to 518"), (400, "no encoder")):
        with pytest.raises(lsdc.SettingsError, match=error):
            lsdc.Completer("small", encoder_side=side)
    try:
        own = lsdc.Completer("anything", encoder_side=252)
    except lsdc.ReadError as error:
        pytest.skip(str(error))
    assert "encoder_side=252" in repr(own)
    found = completed(own, image, sparse)
    assert_array_equal(completed(pickle.loads(pickle.dumps(own)), image, sparse), found)
    assert (completed(lsdc.Completer("anything"), image, sparse) != found).any()


def test_losses_by_name(image, sparse, completer):
    for options in ({"robust": "foo"}, {"fit": {"robust": {"loss": "foo"}}}):
        with pytest.raises(lsdc.SettingsError, match="losses: none, irls, huber, cauchy, gm, tukey, auto"):
            lsdc.Completer("small", **options)
    plain = lsdc.Completer("small", robust="none")
    assert plain.fit["robust"] is None
    robust = lsdc.Completer("small", robust="auto").scene(image)
    assert_array_equal(robust.complete(sparse, robust="none").depth, completed(completer, image, sparse))


def test_settings(image, sparse):
    recorded = lsdc.Completer("small").fit
    changed = lsdc.Completer("small", fit={"joint": {"cosines": 0.0}, "lambda": "gcv"}).fit
    assert changed == {**recorded, "joint": {**recorded["joint"], "cosines": 0.0}, "lambda": "gcv"}
    by_count = [[10.0, 0.1], [100.0, 0.2], [1000.0, 0.3]]
    assert lsdc.Completer("small", fit={"lambda": by_count}).fit["lambda"] == by_count
    # A loss has its own defaults.
    assert lsdc.Completer("small", robust="tukey").fit["robust"]["iterations"] == 40
    assert lsdc.Completer("small", robust={"loss": "irls"}).fit["robust"]["iterations"] == 10
    alone = lsdc.Completer("small", fit={"method": "field"}).complete(image, sparse)
    assert alone.report["method"] == "field"


@pytest.mark.parametrize(
    "options",
    [
        {"fit": {"methd": "lse"}},
        {"fit": {"method": "magic"}},
        {"fit": {"ridge": -1}},
        {"fit": {"ridge": float("nan")}},
        {"fit": {"ridge": np.array([1.0])}},
        {"fit": {"joint": {"wave": 1}}},
        {"fit": {"robust": "auto"}, "robust": "auto"},
        {"robust": "magic"},
        {"robust": {"loss": "auto", "tunning": 1}},
        {"threads": 0},
        {"threads": -1},
        {"fit": "lse"},
        {"robust": True},
        {"threads": 1 << 20},
        {"working_size": (1, 1 << 20)},
    ],
)
def test_settings_out_of_range(options):
    with pytest.raises(lsdc.SettingsError):
        lsdc.Completer("small", **options)


def test_threads_change_no_bit(completer, image, sparse):
    expected = completed(completer, image, sparse)
    for threads in (1, 2, 5):
        own = lsdc.Completer("small", threads=threads)
        assert own.threads == threads
        assert_array_equal(completed(own, image, sparse), expected)


def test_more_pixels_for_the_network(image, sparse):
    own = lsdc.Completer("small", working_size=(64, 48))
    assert_array_equal(completed(own, image, sparse), completed(own, image, sparse))
    assert own.scene(image).size == (64, 48)


def test_many_threads_share_a_completer(completer, image, sparse):
    expected = [completed(completer, image, sparse * factor) for factor in (1, 2, 3)]
    completion = completer.complete(image, sparse)
    deviations = completer.complete(image, sparse).standard_deviation

    def work(i):
        # All threads request the same result for the first time.
        assert_array_equal(completion.standard_deviation, deviations)
        assert_array_equal(completed(completer, image, sparse * (1 + i % 3)), expected[i % 3])
        return threading.get_ident()

    with ThreadPoolExecutor(8) as pool:
        assert len(set(pool.map(work, range(24)))) > 1


def test_other_threads_run_meanwhile(completer, image, sparse):
    # If the interpreter were not released, the loop would end before this thread counts once.
    stop, counted = threading.Event(), []
    switch = sys.getswitchinterval()

    def count():
        while not stop.is_set():
            counted.append(None)

    thread = threading.Thread(target=count)
    sys.setswitchinterval(1e-4)
    thread.start()
    for _ in range(5):
        before = len(counted)
        completer.scene(image)
        assert len(counted) > before
    stop.set()
    thread.join()
    sys.setswitchinterval(switch)


def test_pickles(image, sparse, tmp_path):
    stored = tmp_path / "own.safetensors"
    stored.write_bytes(SMALL.read_bytes())
    own = lsdc.Completer(stored, fit={"method": "lse"}, working_size=(80, 60), threads=1)
    expected, name = completed(own, image, sparse), repr(own)
    pickled = pickle.dumps(own)
    # Another machine does not have the file.
    stored.unlink()
    for other in (pickle.loads(pickled), copy.deepcopy(own)):
        assert repr(other) == name
        assert_array_equal(completed(other, image, sparse), expected)
    assert len(pickle.dumps(lsdc.Completer("small"))) < 200
    for unpicklable in (own.scene(image), own.complete(image, sparse)):
        with pytest.raises(TypeError):
            pickle.dumps(unpicklable)


def test_spawned_processes(completer, image, sparse):
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        calls = [pool.submit(completed, completer, image, sparse) for _ in range(3)]
        for call in calls:
            assert_array_equal(call.result(timeout=120), completed(completer, image, sparse))


def in_child(queue, completer, scene, image, sparse):
    results = [completed(completer, image, sparse), lsdc.complete(image, sparse, weights="small")]
    try:
        scene.complete(sparse)
    except lsdc.Error as error:
        results.append(error)
    queue.put(results)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_forked_processes(image, sparse):
    # The threads of a pool do not survive a fork, so calls must not wait for them.
    completer = lsdc.Completer("small")
    scene, expected = completer.scene(image), completed(completer, image, sparse)
    assert_array_equal(lsdc.complete(image, sparse, weights="small"), expected)
    context = multiprocessing.get_context("fork")
    queue = context.SimpleQueue()
    child = context.Process(target=in_child, args=(queue, completer, scene, image, sparse))
    child.start()
    child.join(60)
    assert child.exitcode == 0
    by_completer, by_function, refused = queue.get()
    assert_array_equal(by_completer, expected)
    assert_array_equal(by_function, expected)
    assert "forked" in str(refused) and refused.hint
    assert_array_equal(scene.complete(sparse).depth, expected)
