"""Every change that the store makes to a file system, each one a method.

A test that wants to see a full disk, a read-only one or a kill in the middle replaces this class
and nothing else.
"""

import os
import shutil
from pathlib import Path


class Disk:
    """The file system as it is."""

    def make_folder(self, path: Path) -> None:
        """Makes a folder and those above it, unless they are there."""
        path.mkdir(parents=True, exist_ok=True)

    def write(self, path: Path, content: bytes) -> None:
        """Writes a file and waits until it is on disk."""
        with path.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())

    def flush_folder(self, path: Path) -> None:
        """Waits until the names in a folder are on disk, where the system knows how to."""
        if os.name == "nt":
            return
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)

    def move(self, old: Path, new: Path) -> None:
        """Gives a file or folder another name, at once; a file that has it is replaced."""
        old.replace(new)

    def remove(self, path: Path) -> None:
        """Removes a file or a folder with all that it holds, if it is there."""
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
