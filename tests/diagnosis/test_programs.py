"""Programs and fits of reference flights are kept for the same inputs, and made anew for others."""

import sys

import jax
import numpy as np
import pytest

from diagnosis.replay.library import make_library
from diagnosis.replay.programs import _files, _key, cached, remembered
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


@pytest.fixture
def program(tmp_path):
    """A program through `cached`; says how often it was traced."""
    before, traced = jax.config.jax_compilation_cache_dir, []
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))

    def run(x, settings="", exclude=(), folder=str(tmp_path)):
        def trace(x):  # a new function each time: JAX keeps what it traced of one
            traced.append(x)
            return 2.0 * x

        jax.config.update("jax_compilation_cache_dir", folder)
        library = make_library(PointMass(dt=0.01), exclude)
        return np.asarray(cached("double", trace, library, settings, (x,))(x))

    yield run, traced
    jax.config.update("jax_compilation_cache_dir", before)


def test_a_program_is_traced_once_for_the_same_library_shapes_and_settings(program, tmp_path):
    run, traced = program
    one = np.arange(3.0)
    np.testing.assert_array_equal(run(one), 2.0 * one)
    np.testing.assert_array_equal(run(one + 1.0), 2.0 * one + 2.0)
    assert len(traced) == 1
    run(one, "other")
    run(one, exclude=["drag"])
    run(np.arange(4.0))
    assert len(traced) == 4
    for path in tmp_path.glob("double-*"):
        path.write_bytes(b"damaged")
    np.testing.assert_array_equal(run(one), 2.0 * one)
    assert len(traced) == 5


def test_a_key_does_not_depend_on_what_else_was_imported(monkeypatch):
    library = make_library(PointMass(dt=0.01))
    before = _key(library, "", (), "diagnosis")
    for name in [n for n in sys.modules if n.startswith(("simulators.rotorpy", "diagnosis.twin"))]:
        monkeypatch.delitem(sys.modules, name)
    assert _key(library, "", (), "diagnosis") == before
    monkeypatch.setattr(sys.modules["simulators"], "__path__", [])
    assert _key(library, "", (), "diagnosis") != before


def test_a_program_is_traced_each_time_where_jax_keeps_nothing(program):
    run, traced = program
    for _ in range(2):
        run(np.arange(3.0), folder=None)
    assert len(traced) == 2


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
