"""Plug-ins that a test installs into a folder."""

import contextlib

import pytest

from simulators import registry


@contextlib.contextmanager
def fresh_registry(site):
    """Inside, the folder `site` is on the path, and its plug-ins are registered."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(site))
        _forget()
        yield
    _forget()


def _forget():
    registry._entry_points.cache_clear()
    registry.load.cache_clear()
