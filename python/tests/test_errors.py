"""Exceptions, and cameras' refusals among them."""

import pickle
import traceback

import pytest

import lsdc

CLASSES = [lsdc.InputError, lsdc.SettingsError, lsdc.WeightsError, lsdc.FitError, lsdc.ReadError]


def test_the_hierarchy():
    assert all(issubclass(error, lsdc.Error) for error in CLASSES)
    assert all(issubclass(error, ValueError) for error in CLASSES[:-1])
    assert issubclass(lsdc.ReadError, OSError) and not issubclass(lsdc.ReadError, ValueError)


@pytest.mark.parametrize("error", [lsdc.Error, *CLASSES])
def test_messages_and_hints_survive_pickling(error):
    for hint in (None, "do that"):
        made = pickle.loads(pickle.dumps(error("this is wrong", hint)))
        assert type(made) is error and str(made) == "this is wrong" and made.hint == hint


def test_tracebacks_show_the_hint(scene):
    with pytest.raises(lsdc.FitError) as caught:
        scene.complete([[1, 1, 0.0]])
    shown = "".join(traceback.format_exception_only(caught.value))
    if hasattr(caught.value, "add_note"):
        assert shown.count("hint: give at least one place") == 1
    assert "lsdc._errors.FitError" in shown or "lsdc.FitError" in shown
