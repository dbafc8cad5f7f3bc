"""One diagnosis in a process of its own: `bench diagnose` without the documents.

python -m blind.run.one FLIGHTS --out DIR [--reference BASE] [--exclude EFFECT]...
"""

import argparse
import sys
from pathlib import Path

from blind.draw.folders import write_json
from blind.run.answering import PROGRAM, sources_digest
from blind.run.children import end, leave_with_parent
from diagnosis.engine import diagnose
from diagnosis.logs.flights import LogError, load_flights


def main() -> int:
    """Exit status: 0, or 2 where the logs hold nothing usable."""
    parser = argparse.ArgumentParser()
    parser.add_argument("flights", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--reference", type=Path)
    parser.add_argument("--exclude", action="append", default=[])
    asked = parser.parse_args()
    sources = sources_digest()  # before a diagnosis that may outlast them
    try:
        reference = load_flights(asked.reference) if asked.reference else None
        found = diagnose(load_flights(asked.flights), reference=reference, exclude=asked.exclude)
    except LogError as error:
        print(error, file=sys.stderr)  # noqa: T201
        return 2
    asked.out.mkdir(parents=True, exist_ok=True)
    write_json(asked.out / PROGRAM, {"sources": sources})
    write_json(asked.out / "diagnosis.json", found.to_json())
    return 0


if __name__ == "__main__":
    leave_with_parent()
    end(main())
