"""Workers whose networks run on GPUs, here a software driver."""

import numpy as np
import pytest
import ray
from conftest import KEYS, command, frame, results

import lsdc
import lsdc.ray
from lsdc.ray._options import Options


def dataset(count):
    return ray.data.from_items([{"key": key, "image": frame(i)[0], "sparse": frame(i)[1]} for i, key in enumerate(KEYS[:count])])


def close(row, expected):
    depth = lsdc.ray.decode(row)
    return row["error"] is None and np.abs(depth - expected.depth).max() < 1e-3 * np.ptp(expected.depth)


def test_a_dataset(gpus, cluster, one_process):
    options = {"weights": "small", "encoding": "f32", "concurrency": 1}
    found = lsdc.ray.complete(dataset(3), **options, device="wgpu:software", num_gpus=0.5).take_all()
    assert len(found) == 3 and all(close(row, one_process[row["key"]]) for row in found)


def test_the_command(gpus, cluster, one_process, folder, tmp_path):
    arguments = (folder, tmp_path / "out", "--encoding", "f32", "--per-shard", 4)
    assert command(*arguments, "--device", "wgpu:software", "--gpus", 1) == 0
    found = results(tmp_path / "out")
    assert len(found) == len(KEYS) and all(close(row, one_process[row["key"]]) for row in found)
    # Depths of the CPU have other bits, and are not mixed with these.
    assert command(*arguments) == 2


def test_a_worker_takes_the_gpu_that_it_is_assigned(gpus, cluster):
    @ray.remote(num_gpus=1, num_cpus=0)
    def device():
        options = Options(lsdc.Completer("small"), device="wgpu")
        (number,) = ray.get_runtime_context().get_accelerator_ids()["GPU"]
        try:
            return number, options.on_worker().device
        except lsdc.SettingsError as error:
            # There is no discrete GPU with this number on most machines.
            return number, str(error)

    number, found = ray.get(device.remote())
    assert found == f"wgpu:{number}" or f"Discrete({number})" in found


def test_useless_requests_are_refused(cluster):
    with pytest.raises(lsdc.SettingsError, match="on the CPU need no GPUs"):
        lsdc.ray.complete(dataset(1), num_gpus=1)
    with pytest.raises(lsdc.SettingsError, match="-1"):
        lsdc.ray.complete(dataset(1), num_gpus=-1)
    with pytest.raises(lsdc.SettingsError, match="unknown device `cuda`"):
        lsdc.ray.complete(dataset(1), device="cuda")
