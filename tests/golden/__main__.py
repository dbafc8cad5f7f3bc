"""`python -m tests.golden`: makes every kept answer again and says where one moved.

Exit status: 0, or 1 where one moved. `--write` keeps what is found now. `--only NAME` takes those
whose name holds NAME. The rows of trainings are compared only on the kind of processor that
made the kept ones.
"""

import argparse
import concurrent.futures
import json
import multiprocessing
import os
import sys
from pathlib import Path

from bench.execution.environment import compute_here
from tests.golden.compare import differences

KEPT = Path(__file__).parent / "kept"
"""One JSON file an answer."""
SHOWN = 12
"""Differences that are listed, an answer."""


def main() -> int:
    """Exit status."""
    parser = argparse.ArgumentParser(description=__doc__, prog="python -m tests.golden")
    parser.add_argument("--write", action="store_true", help="keep what is found now")
    parser.add_argument("--only", default="", help="answers whose name holds this")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    asked = parser.parse_args()
    compute_here()
    # JAX reads the environment when it is first imported.
    from tests.golden.answers import made, makers

    names = [name for name in makers() if asked.only in name]
    if not names:
        parser.error(f"No answer's name holds {asked.only!r}; there are {', '.join(makers())}.")
    # Fresh processes, each with its own JAX: a fork would share its threads' locks.
    spawned = multiprocessing.get_context("spawn")
    wrong = 0
    with concurrent.futures.ProcessPoolExecutor(asked.jobs, mp_context=spawned) as pool:
        futures = {pool.submit(made, name): name for name in names}
        for future in concurrent.futures.as_completed(futures):
            name = futures[future]
            found, seconds = future.result()
            lines = [] if asked.write else _moved(name, found)
            if asked.write:
                _keep(name, found)
            wrong += bool(lines)
            said = "kept" if asked.write else f"{len(lines)} differences" if lines else "same"
            print(f"{name}: {said} ({seconds:.0f} s)", flush=True)  # noqa: T201
            for line in lines[:SHOWN]:
                print(f"    {line}")  # noqa: T201
    print(f"{len(names) - wrong} of {len(names)} answers are the kept ones.")  # noqa: T201
    return 1 if wrong else 0


def _moved(name: str, found: dict) -> list[str]:
    path = KEPT / f"{name}.json"
    if not path.is_file():
        return ["no answer is kept; --write keeps this one"]
    kept = json.loads(path.read_text(encoding="utf-8"))
    if name == "rows" and kept["processor"] != found["processor"]:
        print(f"{name}: not compared, kept on {kept['processor']}")  # noqa: T201
        return []
    return differences(kept["answer"], found["answer"])


def _keep(name: str, found: dict) -> None:
    KEPT.mkdir(exist_ok=True)
    text = json.dumps(found, indent=1, sort_keys=True)
    (KEPT / f"{name}.json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
