"""Checkpoints of the trainings in progress of a run: one file STAGE.npz each, written whole.

What was saved is used again only if it is of this very run, sources and package versions included,
and of a training that begins from the same numbers; else it is left out, and said so in the log.
"""

import io
import logging
import time
import urllib.parse
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from bench.store.disk import Disk
from methods.training.checkpoint import AbstractKeeper

EVERY = 60.0
"""Time between two saves [s]; a kill costs at most that much training."""
LOG = logging.getLogger(__name__)


class Checkpoints(AbstractKeeper):
    """The trainings of one run, under a folder."""

    def __init__(self, folder: Path, about: str, disk: Disk) -> None:
        """Nothing is written before the first save.

        Args:
            folder: Where they are kept.
            about: Text that says what the run is; what was saved under another is not used.
            disk: Writes and removes.
        """
        self._folder = folder
        self._about = about
        self._disk = disk
        self._last = time.monotonic()

    def due(self) -> bool:
        """Whether it is time for the next save."""
        return time.monotonic() - self._last >= EVERY

    def load(self, stage: str, fingerprint: str) -> dict[str, np.ndarray] | None:
        """What was last saved of a training; None if nothing of this very one can be read."""
        path = self._path(stage)
        try:
            with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as stored:
                arrays = dict(stored)
            identity = (str(arrays.pop("about")), str(arrays.pop("fingerprint")))
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            LOG.warning("%s is damaged, so its training starts again: %s", path, error)
            return None
        if identity != (self._about, fingerprint):
            LOG.warning("%s is of another training, which starts again.", path)
            return None
        return arrays

    def save(self, stage: str, fingerprint: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Keeps `arrays` instead of what was saved before; a full disk costs only the save."""
        file = io.BytesIO()
        np.savez(
            file,
            allow_pickle=False,
            about=np.asarray(self._about),
            fingerprint=np.asarray(fingerprint),
            **arrays,
        )
        path = self._path(stage)
        part = path.with_suffix(".part")
        try:
            self._disk.make_folder(self._folder)
            self._disk.write(part, file.getvalue())
            self._disk.move(part, path)
            self._disk.flush_folder(self._folder)
        except OSError as error:
            LOG.warning("%s was not saved, the training goes on: %s", path, error)
        self._last = time.monotonic()

    def _path(self, stage: str) -> Path:
        return self._folder / f"{urllib.parse.quote(stage, safe=' ')}.npz"
