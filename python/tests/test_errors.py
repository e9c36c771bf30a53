"""Exceptions, including those of cameras."""

import copy
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


def test_what_cannot_be_pickled_says_what_to_send(scene, sparse):
    completion = scene.complete(sparse)
    for value, advice in ((scene, "completer"), (completion, "completion.depth"), (lsdc.DepthGuide([[1.0, 2.0]]), "values")):
        with pytest.raises(lsdc.Error, match=f"a {type(value).__name__} cannot be pickled") as caught:
            pickle.dumps(value)
        assert advice in caught.value.hint
        assert copy.copy(value) is value and copy.deepcopy(value) is value


def test_nothing_else_is_in_the_name_space():
    own = {name for name in vars(lsdc) if not name.startswith("_") and name != "ray"}
    assert own == {name for name in lsdc.__all__ if not name.startswith("_")}


def test_tracebacks_show_the_hint(scene):
    with pytest.raises(lsdc.FitError) as caught:
        scene.complete([[1, 1, 0.0]])
    shown = "".join(traceback.format_exception_only(caught.value))
    if hasattr(caught.value, "add_note"):
        assert shown.count("hint: give at least one place") == 1
    assert "lsdc._errors.FitError" in shown or "lsdc.FitError" in shown
