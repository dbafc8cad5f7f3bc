"""New folders that are written whole or not at all."""

import contextlib
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from bench.text.errors import UsageError


def check_free(folder: Path) -> None:
    """Refuses a folder in which something lies already.

    Raises:
        UsageError: It is a file, or a folder that is not empty.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UsageError(
            f"{folder} is there already and would be overwritten. Give another folder with --out, "
            "or remove it."
        )


@contextlib.contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """Inside, a folder to write to, which is moved to `out` at the end; an error leaves nothing.

    Raises:
        UsageError: `out` is not free.
    """
    check_free(out)
    place = out.absolute()
    place.parent.mkdir(parents=True, exist_ok=True)
    part = Path(tempfile.mkdtemp(prefix=f".{place.name}-", dir=place.parent))
    try:
        part.chmod(0o755)  # as any new folder; a temporary one is its owner's alone
        yield part
        part.replace(place)
    finally:
        shutil.rmtree(part, ignore_errors=True)
