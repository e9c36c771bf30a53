"""The examples in docstrings and in the README, and the stub of the extension module."""

import doctest
import importlib
import pkgutil
from pathlib import Path

import pytest

import lsdc

MODULES = ["lsdc", *(f"lsdc.{module.name}" for module in pkgutil.iter_modules(lsdc.__path__))]
OPTIONS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS


@pytest.mark.parametrize("name", MODULES)
def test_examples_of(name, names):
    if name == "lsdc.ray":
        pytest.importorskip("ray", reason="Ray is not installed")
    module = importlib.import_module(name)
    failed, _ = doctest.testmod(module, extraglobs=names, optionflags=OPTIONS)
    assert failed == 0


def test_examples_of_the_readme(names):
    readme = Path(__file__).parents[1] / "README.md"
    failed, run = doctest.testfile(str(readme), module_relative=False, globs=dict(names), optionflags=OPTIONS)
    assert failed == 0 and run > 0
