"""A cluster of three nodes gives every frame once, with the bits of one process, whatever is killed."""

import io
import json
import os
import signal
import sys
import tarfile

import numpy as np
import pyarrow.parquet as pq
import pytest
import ray
from conftest import KEYS, as_npy, command, frame, results, same, write_tar

import lsdc
import lsdc.ray
from lsdc.ray import _command
from lsdc.ray._attempts import GIVEN_UP
from lsdc.ray._frame import Frame, Inputs
from lsdc.ray._options import Options
from lsdc.ray._place import Place
from lsdc.ray._plan import planned
from lsdc.ray._run import run
from lsdc.ray._shards import Destination

EXACT = ("--encoding", "f32", "--per-shard", 2)


def test_a_dataset(cluster, one_process):
    rows = [{"key": key, "image": frame(i)[0], "sparse": frame(i)[1]} for i, key in enumerate(KEYS)]
    dataset = ray.data.from_items(rows, override_num_blocks=4)
    options = {"weights": "small", "encoding": "f32", "standard_deviation": True, "batch_size": 2}
    found = lsdc.ray.complete(dataset, **options).take_all()
    assert same(found, one_process)
    for row in found:
        deviation = lsdc.ray.decode(row, "standard_deviation")
        np.testing.assert_array_equal(deviation, one_process[row["key"]].standard_deviation)


def test_points_bytes_and_broken_rows_of_a_dataset(cluster, one_process):
    image, sparse = frame(0)
    down, across = np.nonzero(sparse)
    points = np.column_stack([across, down, sparse[down, across]])
    rows = [
        {"name": "points", "rgb": image, "depths": as_npy(points)},
        {"name": "millimetres", "rgb": image, "depths": as_npy((sparse * 1000).round().astype(np.uint16))},
        {"name": "empty", "rgb": image, "depths": as_npy(sparse * 0)},
        {"name": "damaged", "rgb": image, "depths": as_npy(sparse)[:50]},
    ]
    names = {"key": "name", "image": "rgb", "sparse": "depths"}
    dataset = ray.data.from_items(rows)
    found = lsdc.ray.complete(dataset, **names, weights="small", encoding="f32", concurrency=1).take_all()
    row = {row["key"]: row for row in found}
    np.testing.assert_array_equal(lsdc.ray.decode(row["points"]), one_process[KEYS[0]].depth)
    assert "unit" in row["millimetres"]["error"]
    assert "no sparse depth" in row["empty"]["error"] and "npy" in row["damaged"]["error"]
    assert lsdc.ray.decode(row["empty"]) is None


def test_a_dataset_without_a_column(cluster):
    with pytest.raises(lsdc.InputError, match="no column `sparse`"):
        lsdc.ray.complete(ray.data.from_items([{"key": "a", "image": frame(0)[0]}]).materialize())


@pytest.mark.parametrize("kind", ["folder", "tars", "tables"])
def test_the_command(cluster, one_process, kind, request, tmp_path):
    source, dest = request.getfixturevalue(kind), tmp_path / "out"
    assert command(source, dest, *EXACT) == 0
    assert same(results(dest), one_process)
    assert (dest / "failures.csv").read_text() == "key,shard,error\n"
    assert sorted(path.name for path in dest.iterdir()) == ["data", "done", "failures.csv", "plan.json"]


def test_what_is_there_is_not_made_again_and_what_is_lost_has_the_same_bytes(
    cluster, one_process, folder, tmp_path
):
    dest = tmp_path / "out"
    assert command(folder, dest, *EXACT) == 0
    shards = sorted((dest / "data").iterdir())
    before = [(shard.stat().st_mtime_ns, shard.read_bytes()) for shard in shards]
    # As if a worker had died before writing its shard, and another one after.
    shards[1].unlink()
    for number in (1, 3):
        (dest / f"done/{shards[number].stem}.json").unlink()
    assert command(folder, dest, *EXACT) == 0
    assert [shard.read_bytes() for shard in shards] == [data for _, data in before]
    kept = [shard.stat().st_mtime_ns == time for shard, (time, _) in zip(shards, before, strict=True)]
    assert kept == [number not in (1, 3) for number in range(6)]
    assert same(results(dest), one_process)


def test_broken_frames_are_listed(cluster, one_process, folder, tmp_path, capsys):
    (folder / f"images/{KEYS[3]}.png").write_bytes(b"no picture")
    (folder / f"sparse/{KEYS[4]}.npy").unlink()
    dest = tmp_path / "out"
    assert command(folder, dest, *EXACT) == 3
    assert "11 of 11 frames, 2 failed" in capsys.readouterr().out
    rows = results(dest)
    assert [row["key"] for row in rows] == KEYS
    assert [row["key"] for row in rows if row["error"]] == KEYS[3:5]
    good = [row for row in rows if not row["error"]]
    assert same(good, {row["key"]: one_process[row["key"]] for row in good})
    lines = (dest / "failures.csv").read_text().splitlines()
    assert len(lines) == 3 and KEYS[3] in lines[1] and "no depths" in lines[2]
    # Nothing is left to do, but the failures remain.
    assert command(folder, dest, *EXACT) == 3


def test_tars_of_results(cluster, one_process, tables, tmp_path):
    dest = tmp_path / "out"
    assert command(tables, dest, *EXACT, "--format", "tar", "--standard-deviation") == 0
    found = {}
    for file in sorted((dest / "data").iterdir()):
        with tarfile.open(file) as tar:
            for member in tar:
                assert member.name not in found
                found[member.name] = tar.extractfile(member).read()
    assert len(found) == 3 * len(KEYS)
    for key, completion in one_process.items():
        np.testing.assert_array_equal(np.load(io.BytesIO(found[f"{key}.depth.npy"])), completion.depth)
        deviation = np.load(io.BytesIO(found[f"{key}.standard_deviation.npy"]))
        np.testing.assert_array_equal(deviation, completion.standard_deviation)
        assert json.loads(found[f"{key}.json"])["report"]["used"] == 192


def test_a_frame_that_kills_its_worker_is_given_up(cluster, one_process, tmp_path):
    # Workers do not have this folder.
    ray.cloudpickle.register_pickle_by_value(sys.modules[frame.__module__])

    class Source:
        def files(self):
            return [""]

        def index(self, file):
            return [(key, number) for number, key in enumerate(KEYS)]

        def reference(self, file, entries):
            return list(entries)

        def frames(self, reference):
            for key, number in reference:
                yield Frame(key, lambda number=number: self.inputs(number))

        def inputs(self, number):
            if number == 4:
                os.kill(os.getpid(), signal.SIGKILL)
            return Inputs(*frame(number))

    destination = Destination(Place(str(tmp_path)), "parquet")
    options = Options(lsdc.Completer("small", threads=1), encoding="f32")
    run(planned(Source(), 6).shards, Source(), options, destination)
    rows = {row["key"]: row for row in results(tmp_path)}
    assert f"{GIVEN_UP} workers died" in rows.pop(KEYS[4])["error"]
    assert same(list(rows.values()), {key: one_process[key] for key in rows})


def test_a_shard_that_cannot_be_made(cluster, one_process, tars, tmp_path, capsys):
    """The source has changed since the plan was made."""
    dest = tmp_path / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_command, "_connected", lambda args: write_tar(tars / "b.tar", KEYS[5:9]))
        assert command(tars, dest, *EXACT) == 3
    said = capsys.readouterr()
    assert "9 of 11 frames" in said.out and "1 shards could not be made" in said.err
    assert "warning: shard-0000005: " in said.err
    assert sorted(row["key"] for row in results(dest)) == KEYS[:9]
    write_tar(tars / "b.tar", KEYS[5:])
    assert command(tars, dest, *EXACT) == 0
    assert same(results(dest), one_process)


def test_a_node_that_dies(cluster, one_process, folder, tmp_path):
    """A node is killed when the first shard is finished."""
    dest = tmp_path / "out"
    victim = cluster.add_node(num_cpus=1, object_store_memory=80 << 20)
    killed = []
    add = _command._Progress.add

    def kill(self, summary):
        if not killed:
            cluster.remove_node(victim, allow_graceful=False)
            killed.append(victim)
        add(self, summary)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_command._Progress, "add", kill)
        assert command(folder, dest, "--encoding", "f32", "--per-shard", 1) == 0
    assert killed and same(results(dest), one_process)


def test_an_object_store(cluster, one_process, tars, tmp_path, store):
    """An object store as source and destination."""
    source, dest = Place(store("frames")), Place(store("out"))
    for file in tars.iterdir():
        source.write(file.name, file.read_bytes())
    assert command(source.address, dest.address, *EXACT) == 0
    assert [name for name in dest.files() if not name.startswith(("data/", "done/"))] == [
        "failures.csv",
        "plan.json",
    ]
    names = [name for name in dest.files("data")]
    rows = [row for name in names for row in pq.read_table(dest.open(name)).to_pylist()]
    assert same(rows, one_process)
    assert command(source.address, dest.address, *EXACT) == 0
