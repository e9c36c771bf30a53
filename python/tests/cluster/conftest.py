"""Frames in every format, and a cluster of three nodes on this machine."""

import io
import json
import tarfile

import numpy as np
import pytest

Image = pytest.importorskip("PIL.Image")

import pyarrow as pa
import pyarrow.parquet as pq

import lsdc
import lsdc.ray
from lsdc.ray import _command

KEYS = [f"room/{number:02}" for number in range(11)]


def frame(number):
    """An image of 64x48 and its depths, different for every number."""
    down, across = np.mgrid[:48, :64]
    image = np.stack([across * 3, down * 4, across + down + number], axis=-1).astype(np.uint8)
    sparse = np.zeros((48, 64), np.float32)
    sparse[2::4, 2::4] = (1.5 + number / 10 + across / 64.0)[2::4, 2::4]
    return image, sparse


def as_png(image):
    data = io.BytesIO()
    Image.fromarray(image).save(data, "png")
    return data.getvalue()


def as_npy(values):
    data = io.BytesIO()
    np.save(data, values)
    return data.getvalue()


@pytest.fixture(scope="session")
def one_process():
    """Results of one process, by key."""
    completer = lsdc.Completer("small")
    return {key: completer.complete(*frame(number)) for number, key in enumerate(KEYS)}


@pytest.fixture
def folder(tmp_path):
    """A folder with `images` and `sparse`."""
    source = tmp_path / "frames"
    for number, key in enumerate(KEYS):
        image, sparse = frame(number)
        for name, data in (("images", as_png(image)), ("sparse", as_npy(sparse))):
            path = source / name / f"{key}{'.png' if name == 'images' else '.npy'}"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
    return source


def write_tar(path, keys):
    with tarfile.open(path, "w") as tar:
        for key in keys:
            image, sparse = frame(KEYS.index(key))
            for ending, data in (("png", as_png(image)), ("sparse.npy", as_npy(sparse)), ("txt", b"a room")):
                member = tarfile.TarInfo(f"{key}.{ending}")
                member.size = len(data)
                tar.addfile(member, io.BytesIO(data))


@pytest.fixture
def tars(tmp_path):
    source = tmp_path / "tars"
    source.mkdir()
    write_tar(source / "a.tar", KEYS[:5])
    write_tar(source / "b.tar", KEYS[5:])
    return source


@pytest.fixture
def tables(tmp_path):
    source = tmp_path / "tables"
    source.mkdir()
    rows = [frame(number) for number in range(len(KEYS))]
    table = pa.table(
        {
            "key": KEYS,
            "image": [{"bytes": as_png(image), "path": None} for image, _ in rows],
            "sparse": [as_npy(sparse) for _, sparse in rows],
        }
    )
    pq.write_table(table.slice(0, 7), source / "a.parquet", row_group_size=3)
    pq.write_table(table.slice(7), source / "b.parquet")
    return source


@pytest.fixture(scope="session")
def cluster():
    import ray
    from ray.cluster_utils import Cluster

    common = {"object_store_memory": 80 << 20}
    made = Cluster(
        initialize_head=True,
        head_node_args={**common, "num_cpus": 0, "include_dashboard": False},
    )
    try:
        for number in range(3):
            made.add_node(num_cpus=1, num_gpus=int(number == 0), **common)
        ray.init(address=made.address, log_to_driver=False, logging_level="error")
        made.wait_for_nodes()
        yield made
    finally:
        ray.shutdown()
        made.shutdown()


@pytest.fixture
def store():
    """Returns addresses of folders in a local object store."""
    server = pytest.importorskip("moto.server", reason="moto is not installed")
    boto3 = pytest.importorskip("boto3")
    running = server.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    running.start()
    host, port = running.get_host_and_port()
    login = {"aws_access_key_id": "key", "aws_secret_access_key": "secret", "region_name": "us-east-1"}
    boto3.client("s3", endpoint_url=f"http://{host}:{port}", **login).create_bucket(Bucket="bucket")
    options = f"endpoint_override={host}:{port}&scheme=http&region=us-east-1"
    yield lambda folder: f"s3://key:secret@bucket/{folder}?{options}"
    running.stop()


def results(dest, ending="parquet"):
    """Returns the rows of a folder of results."""
    files = sorted((dest / "data").glob(f"*.{ending}"))
    return [row for file in files for row in pq.read_table(file).to_pylist()]


def command(*arguments):
    """Runs the command in this process, and returns its exit code."""
    return _command.main([*map(str, arguments), "--weights", "small", "--quiet"])


def same(rows, one_process):
    """Checks that every key occurs once, with the bits of one process."""
    assert sorted(row["key"] for row in rows) == sorted(one_process)
    for row in rows:
        assert row["error"] is None
        np.testing.assert_array_equal(lsdc.ray.decode(row), one_process[row["key"]].depth)
        assert json.loads(row["report"])["used"] == 192
    return True

