"""Hashes of the code that a plug-in runs."""

import importlib
import sys

import pytest

from bench.plan import sources
from bench.plan.sources import own_source, shared_sources


def test_words_change_no_hash_and_code_does(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "their_help.py").write_text("SIZE = 1\n")
    texts = {
        "their_first": "from their_help import SIZE\nclass One:\n    size = SIZE\n",
        "their_words": '"""Said."""\nfrom their_help import SIZE\n\n\nclass One:\n    # why\n'
        "    size = SIZE\n",
        "their_other": "from their_help import SIZE\nclass One:\n    size = 2 * SIZE\n",
    }
    for name, text in texts.items():
        (tmp_path / f"{name}.py").write_text(text)
    found = {name: own_source(importlib.import_module(name).One) for name in texts}
    assert found["their_first"] == found["their_words"] != found["their_other"]
    one = importlib.import_module("their_first").One
    assert set(shared_sources([one])) == set()  # another package's, which has a version


PLAIN = """
class Gain(Base):
    size: float | None = None

    def act(self, x, *rest, dt=0.002):
        try:
            return [f"{k:.3f} {x!r}" for k in rest if k] or (lambda: dt)()
        except (KeyError, ValueError):
            pass
"""
"""Statements whose trees other versions of Python write in other ways."""


def test_hashes_are_the_same_in_every_version_of_python():
    assert sources._hash(PLAIN) == "4c9f1a7660a3efd0"  # as Python 3.11, 3.12 and 3.13 give it


@pytest.mark.parametrize(
    "line", ["from .help import SIZE", "from . import help", "import their.help"]
)
def test_help_from_the_plug_ins_own_package_counts_however_it_is_imported(
    tmp_path, monkeypatch, line
):
    monkeypatch.syspath_prepend(tmp_path)
    package = tmp_path / "their"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "help.py").write_text("from . import deeper\nSIZE = 1\n")
    (package / "deeper.py").write_text("DEPTH = 2\n")
    (package / "plugin.py").write_text(f"{line}\n\nclass One:\n    pass\n")
    one = importlib.import_module("their.plugin").One
    assert {"their.help", "their.deeper"} <= set(shared_sources([one]))
    for name in [name for name in sys.modules if name.split(".")[0] == "their"]:
        del sys.modules[name]
    sources._text.cache_clear()
    sources._imports.cache_clear()
