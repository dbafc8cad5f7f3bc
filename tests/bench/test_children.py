"""Processes that do the parts of a blind study."""

import subprocess
import sys
import time

import pytest
from filelock import FileLock, Timeout

CHILD = """
import sys, time
from filelock import FileLock
from blind.run.children import leave_with_parent
leave_with_parent()
with FileLock(sys.argv[1]), open(sys.argv[2], "w"):
    time.sleep(600.0)
"""
PARENT = """
import sys
from pathlib import Path
from blind.run.children import Task, python, run_tasks
here = Path(sys.argv[1])
command = python(*(str(here / name) for name in ("child.py", "lock", "there")))
run_tasks([Task("one", command, here, here)], 1, print)
"""
WAIT = 120.0


def test_a_child_leaves_with_a_parent_that_was_killed(tmp_path):
    (tmp_path / "child.py").write_text(CHILD, encoding="utf-8")
    lock = FileLock(tmp_path / "lock")
    parent = subprocess.Popen([sys.executable, "-c", PARENT, str(tmp_path)])
    end = time.monotonic() + WAIT
    while not (tmp_path / "there").exists():
        assert parent.poll() is None
        assert time.monotonic() < end
        time.sleep(0.1)
    with pytest.raises(Timeout):
        lock.acquire(timeout=0.0)
    parent.kill()
    parent.wait()
    with lock.acquire(timeout=WAIT):
        pass
