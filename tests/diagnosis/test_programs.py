"""Fits of reference flights are remembered for the same arrays, and made anew for others."""

import sys

import numpy as np
import pytest

from diagnosis.replay.library import make_library
from diagnosis.replay.programs import _files, _key, remembered
from simulators.point_mass import PointMass


@pytest.fixture
def fitted(tmp_path, monkeypatch):
    """Fits through `remembered`; says what was made how often."""
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path))
    library, made = make_library(PointMass(dt=0.01)), []

    def fit(array, settings="", exclude=()):
        def make():
            made.append(array)
            return {"sum": np.asarray(np.sum(array)), "whole": array}

        place = make_library(PointMass(dt=0.01), exclude) if exclude else library
        return remembered("fit", make, place, settings, [array])

    return fit, made


def test_what_was_fitted_is_remembered_for_the_same_flights_only(fitted):
    fit, made = fitted
    one = np.arange(3.0)
    first, again = fit(one), fit(one.copy())
    assert len(made) == 1
    np.testing.assert_array_equal(again["whole"], first["whole"])
    for count, other in enumerate([(one + 1e-9,), (one, "other"), (one, "", ["drag"])], 2):
        fit(*other)
        assert len(made) == count


@pytest.mark.parametrize("content", [b"", b"no archive", None])
def test_a_damaged_memory_is_made_anew(fitted, tmp_path, content):
    fit, made = fitted
    fit(np.arange(3.0))
    (path,) = tmp_path.glob("fit-*.npz")
    path.write_bytes(path.read_bytes()[:-30] if content is None else content)
    again = fit(np.arange(3.0))
    assert len(made) == 2
    assert again["sum"] == 3.0
    fit(np.arange(3.0))
    assert len(made) == 2


def test_without_a_folder_nothing_is_remembered(fitted, monkeypatch):
    fit, made = fitted
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR")
    fit(np.arange(3.0))
    fit(np.arange(3.0))
    assert len(made) == 2


def test_a_folder_that_cannot_be_written_to_is_no_error(fitted, tmp_path, monkeypatch):
    fit, made = fitted
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "file"))
    assert fit(np.arange(3.0))["sum"] == 3.0
    assert len(made) == 1


def test_a_package_of_nothing_but_a_name_can_be_hashed(tmp_path, monkeypatch):
    """An effect's package may have an empty `__init__.py`."""
    (tmp_path / "hollow_plugin").mkdir()
    empty = tmp_path / "hollow_plugin" / "__init__.py"
    empty.touch()
    monkeypatch.syspath_prepend(tmp_path)
    __import__("hollow_plugin")
    library = make_library(PointMass(dt=0.01))
    assert empty in _files(library, "hollow_plugin")
    before = _key(library, "", (), "hollow_plugin")
    empty.write_text("LENGTH = 1\n")
    assert _key(library, "", (), "hollow_plugin") != before
    monkeypatch.delitem(sys.modules, "hollow_plugin")
