"""Sources, plans and shards, without a cluster."""

import io
import json
import tarfile

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from conftest import KEYS, as_npy, as_png, frame, write_tar
from numpy.testing import assert_array_equal

import lsdc
import lsdc.ray
from lsdc.ray._attempts import GIVEN_UP, Attempts
from lsdc.ray._frame import Frame, Inputs, as_depths, completed, encoded
from lsdc.ray._options import Options
from lsdc.ray._place import Place
from lsdc.ray._plan import planned
from lsdc.ray._shards import Destination
from lsdc.ray._sources import opened


def source(path, sparse=None, columns=()):
    return opened(str(path), sparse and str(sparse), dict(columns))


@pytest.mark.parametrize("kind", ["folder", "tars", "tables"])
@pytest.mark.parametrize("per_shard", [1, 2, 4, 100])
def test_shards_hold_every_frame_in_order(kind, per_shard, request):
    frames = source(request.getfixturevalue(kind))
    plan = planned(frames, per_shard)
    assert plan == planned(frames, per_shard)
    assert plan.frames == len(KEYS)
    assert len({shard.name for shard in plan.shards}) == len(plan.shards)
    found = []
    for shard in plan.shards:
        some = list(frames.frames(json.loads(shard.reference)))
        assert len(some) == shard.frames <= per_shard
        found += some
    assert [some.key for some in found] == KEYS
    for number, some in enumerate(found):
        inputs, (image, sparse) = some.decode(), frame(number)
        assert_array_equal(np.asarray(inputs.image), image)
        assert_array_equal(inputs.sparse, sparse)


def test_other_columns(tmp_path):
    image, sparse = frame(0)
    points = [[2.0, 3.0, 1.5], [40.0, 30.0, 2.0]]
    table = pa.table(
        {"id": [7], "rgb": [as_png(image)], "lidar": [points], "spread": [as_npy(sparse)], "image": [b""]}
    )
    pq.write_table(table, tmp_path / "a.parquet")
    columns = {"key": "id", "image": "rgb", "sparse": "lidar", "sigma": "spread"}
    frames = source(tmp_path / "a.parquet", columns=columns)
    (shard,) = planned(frames, 9).shards
    (found,) = frames.frames(json.loads(shard.reference))
    inputs = found.decode()
    assert found.key == "7"
    assert_array_equal(np.stack(list(inputs.sparse)), points)
    assert_array_equal(inputs.sigma, sparse)
    with pytest.raises(lsdc.InputError, match="no column `key`"):
        planned(source(tmp_path), 9)
    with pytest.raises(lsdc.InputError, match="no part"):
        source(tmp_path, columns={"colour": "rgb"})


def test_frames_that_are_incomplete_fail_alone(tmp_path):
    with tarfile.open(tmp_path / "a.tar", "w") as tar:
        for name, data in (("a.png", as_png(frame(0)[0])), ("__note", b"x"), ("b.jpg", b"no picture"), ("b.npy", b"")):
            member = tarfile.TarInfo(name)
            member.size = len(data)
            tar.addfile(member, io.BytesIO(data))
    frames = source(tmp_path / "a.tar")
    options = Options(lsdc.Completer("small"))
    (shard,) = planned(frames, 9).shards
    rows = [completed(some, options.completer, options) for some in frames.frames(json.loads(shard.reference))]
    assert [row["key"] for row in rows] == ["a", "b"]
    assert "no sparse depths" in rows[0]["error"] and rows[1]["error"] and rows[1]["depth"] is None


@pytest.mark.parametrize("kind", ["tar", "parquet", "folder"])
def test_keys_that_occur_twice(kind, tmp_path):
    if kind == "tar":
        write_tar(tmp_path / "a.tar", KEYS[:3])
        write_tar(tmp_path / "b.tar", KEYS[2:4])
    elif kind == "parquet":
        pq.write_table(pa.table({"key": ["a", "a"], "image": ["", ""], "sparse": ["", ""]}), tmp_path / "a.parquet")
    else:
        for name in ("images/a.png", "images/a.jpg", "sparse/a.npy"):
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name).write_bytes(b"")
    with pytest.raises(lsdc.InputError, match="occurs twice"):
        planned(source(tmp_path), 9)


def test_sources_that_are_none(tmp_path, folder):
    with pytest.raises(lsdc.ReadError, match="no files"):
        source(tmp_path / "nothing")
    with pytest.raises(lsdc.InputError, match="nothing of depths"):
        source(folder / "images")
    with pytest.raises(lsdc.InputError, match="is called as"):
        planned(source(folder / "images", tmp_path), 9)
    (tmp_path / "a.tar").write_bytes(b"no tar")
    with pytest.raises(lsdc.ReadError, match="no sound tar"):
        planned(source(tmp_path / "a.tar"), 9)
    (tmp_path / "a.parquet").write_bytes(b"no table")
    with pytest.raises(lsdc.ReadError, match="no sound Parquet"):
        planned(source(tmp_path / "a.parquet"), 9)


def test_maps_in_another_folder(folder):
    frames = source(folder / "images", folder / "sparse")
    assert planned(frames, 4) == planned(source(folder), 4)


def test_images_of_16_bits_are_depths():
    from PIL import Image

    steps = np.arange(12, dtype=np.uint16).reshape(3, 4) * 5000
    data = io.BytesIO()
    Image.fromarray(steps).save(data, "png")
    assert_array_equal(as_depths(data.getvalue()), steps)
    with pytest.raises(lsdc.InputError, match="16 bits"):
        as_depths(as_png(frame(0)[0]))


@pytest.mark.parametrize(
    ("encoding", "values", "stored", "clipped"),
    [
        ("u16", [0.0004, 0.0016, 2.0004, 65.535, 70.0], [0.001, 0.002, 2.0, 65.535, 65.535], 2),
        ("f16", [1e-9, 1.0, 1 / 3, 65504.0, 1e6], [2.0**-24, 1.0, 0.33325195, 65504.0, 65504.0], 2),
        ("f32", [1e-9, 1.0, 1 / 3, 65504.0, 1e6], [1e-9, 1.0, 1 / 3, 65504.0, 1e6], 0),
    ],
)
def test_encodings(encoding, values, stored, clipped):
    data, count = encoded(np.array([values], np.float32), encoding, 0.001)
    row = {"depth": data.tobytes(), "encoding": encoding, "step": 0.001, "height": 1, "width": len(values)}
    assert count == clipped
    np.testing.assert_allclose(lsdc.ray.decode(row)[0], stored, rtol=1e-6)


@pytest.mark.parametrize("format", ["parquet", "tar"])
def test_the_same_rows_make_the_same_bytes(format, tmp_path):
    options = Options(lsdc.Completer("small"), standard_deviation=True)
    found = []
    for name in ("a", "b"):
        place = Place(str(tmp_path / name))
        destination = Destination(place, format)
        frames = [Frame(key, lambda i=i: Inputs(*frame(i))) for i, key in enumerate(KEYS[:3])]
        rows = (completed(some, options.completer, options) for some in frames)
        summary = destination.put("shard-0000000", rows, lambda: 0.0)
        assert summary["frames"] == 3 and not summary["failed"]
        assert destination.finished() == {"shard-0000000"}
        found.append(place.read(f"data/shard-0000000.{format}"))
    assert found[0] == found[1]


def test_nothing_is_half_written(tmp_path):
    destination = Destination(Place(str(tmp_path)), "parquet")

    def rows():
        yield dict.fromkeys(lsdc.ray.SCHEMA.names) | {"key": "a", "error": "none"}
        raise OSError("the store is gone")

    with pytest.raises(OSError, match="gone"):
        destination.put("shard-0000000", rows(), lambda: 0.0)
    assert destination.finished() == set() and not list(tmp_path.rglob("*.parquet"))


def test_a_folder_belongs_to_one_plan(tmp_path):
    destination = Destination(Place(str(tmp_path)), "parquet")
    destination.begin({"frames": 3, "unit": None, "size": (4, 3)})
    destination.begin({"frames": 3, "unit": None, "size": (4, 3)})
    with pytest.raises(lsdc.SettingsError, match=r"another `unit`: null, now 0\.1"):
        destination.begin({"frames": 3, "unit": 0.1, "size": (4, 3)})
    (tmp_path / "other").mkdir()
    (tmp_path / "other/file").write_text("")
    with pytest.raises(lsdc.SettingsError, match="other files"):
        Destination(Place(str(tmp_path / "other")), "tar").begin({})


def test_a_frame_is_given_up_after_deaths_at_it(tmp_path):
    place = Place(str(tmp_path))

    def attempt(*keys):
        attempts = Attempts(place, "shard")
        return [attempts.begin(key) for key in keys]

    # The frame at which the first worker died is unknown.
    assert attempt("a", "b") == [None, None]
    for _ in range(GIVEN_UP):
        assert attempt("a", "b") == [None, None]
    last = Attempts(place, "shard")
    assert last.begin("a") is None and f"{GIVEN_UP} workers died" in last.begin("b")
    # A frame that ends with an exception is not a death.
    last.begin("a")
    last.pause()
    assert Attempts(place, "shard").begin("a") is None


def test_places(tmp_path):
    memory = pytest.importorskip("fsspec").filesystem("memory")
    memory.pipe("/bucket/a/b.txt", b"content")
    for place in (Place("memory://bucket"), Place(str(tmp_path))):
        place.write("a/b.txt", b"content")
        assert place.files() in (["a/b.txt"], ["a/b.txt", "tmp"]) and place.read("a/b.txt") == b"content"
        assert place.is_file("a/b.txt") and place.is_folder("a") and not place.is_file("c")
        assert place.child("a").files() == ["b.txt"]
        with pytest.raises(lsdc.ReadError, match="there is no"):
            place.read("c")
    with pytest.raises(lsdc.SettingsError, match="cannot be opened"):
        Place("nowhere://x").files()
