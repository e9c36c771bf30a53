"""Arguments that are refused before a cluster is used."""

import subprocess
import sys

import pytest
from conftest import command

import lsdc
import lsdc.ray
from lsdc.ray import _command
from lsdc.ray._options import Options


@pytest.fixture(autouse=True)
def no_cluster(monkeypatch):
    def connected(args):
        raise AssertionError("a cluster is used")

    monkeypatch.setattr(_command, "_connected", connected)


@pytest.mark.parametrize(
    "options",
    [
        ("--weights", "huge"),
        ("--fit", '{"method": "best"}'),
        ("--fit", "{"),
        ("--robust", "very"),
        ("--unit", "-1"),
        ("--sigma", "0"),
        ("--size", "0x5"),
        ("--step", "nan"),
        ("--cpus", "0"),
        ("--per-shard", "0"),
        ("--column", "image=rgb"),
        ("--sparse", "nowhere"),
    ],
)
def test_options(folder, tmp_path, options, capsys):
    arguments = [str(folder), str(tmp_path / "out"), "--weights", "small", *options]
    assert _command.main(arguments) == 2
    assert "error: " in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_words_that_are_no_options(folder, tmp_path):
    for options in (["--unit", "miles"], ["--size", "5"], ["--column", "image"], ["--encoding", "u8"]):
        with pytest.raises(SystemExit) as exit:
            _command.main([str(folder), str(tmp_path / "out"), *options])
        assert exit.value.code == 2


def test_results_among_frames(folder, tmp_path, capsys):
    assert command(folder, folder / "out") == 2
    assert command(tmp_path / "nothing", tmp_path / "out") == 2


def test_keys_that_tars_cannot_hold(tmp_path, folder, capsys):
    (folder / "images/a.b.png").write_bytes(b"")
    assert command(folder, tmp_path / "out", "--format", "tar") == 2
    assert "has a dot" in capsys.readouterr().err


@pytest.mark.parametrize(
    "options", [{"encoding": "u8"}, {"order": "rbg"}, {"unit": "mile"}, {"size": (1,)}, {"sigma": -1}]
)
def test_options_of_a_dataset(options):
    with pytest.raises(lsdc.Error):
        Options(lsdc.Completer("small"), **options)


def test_ray_is_not_imported_unless_asked_for():
    script = "import lsdc, sys; assert not {'ray', 'pyarrow'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", script], check=True)
