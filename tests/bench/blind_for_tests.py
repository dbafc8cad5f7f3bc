"""A blind run for tests: cases as if flown, a stub in the place of `bench diagnose`, tables."""

from rich.console import Console

from blind.draw.cases import Case, read_labels, write_labels
from blind.draw.catalogue import Withheld
from blind.draw.folders import Folders, write_json
from blind.report.tables import make_tables
from blind.run.answering import answer_shown, missing, read_documents

STUB = """
import json, os, pathlib, sys
content = json.loads(pathlib.Path(sys.argv[0]).with_name("effect.json").read_text())
flights, out = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
what = (flights / "flights" / "what").read_text()
if what == "crash":
    sys.exit("no such luck")
if what == "hang":
    import time; time.sleep(60)
out.mkdir()
content["effects"][0]["name"] = what
if what == "none":
    content |= {"verdict": "none", "effects": []}
seen = {"argv": sys.argv[1:], "cwd": os.listdir("."), "environment": sorted(os.environ),
        "beside": sorted(p.name for p in flights.parent.iterdir())}
(out / "seen.json").write_text(json.dumps(seen))
(out / "diagnosis.json").write_text(json.dumps(content) if what != "half" else '{"schema": 2, ')
"""


def case(number, kind, *effects):
    return Case(f"{number:016x}", kind, effects, "small" if effects else "", seed=number)


MASS = case(1, "single", Withheld("mass", {"e": 0.12}))
GAIN = case(2, "excluded", Withheld("thrust_gain", {"e": -0.1}))
CLEAN = case(3, "clean")


def made(out, *cases):
    """Folders of cases as if they had been flown; each with what the stub shall say of it."""
    folders = Folders(out)
    for flown in (folders.reference, folders.undisturbed):
        flown.mkdir(parents=True)
    for one, what in cases:
        place = folders.cases / one.id / "flights"
        for folder in (place, folders.labels.parent / "true" / one.id):
            folder.mkdir(parents=True)
        (place / "what").write_text(what)
    sha256 = write_labels(folders.labels, [one for one, _ in cases])
    counts = {"single": 1, "pair": 0, "clean": 1, "unknown": 0, "excluded": 1}
    write_json(
        folders.state,
        {
            "reality": "crazyflow",
            "counts": counts,
            "seed": 5,
            "sha256": sha256,
            "started": "2026-01-01",
            "versions": {"fidelity-bench": "0"},
        },
    )
    return folders


def answered(folders):
    """Statuses by case after answering what is missing."""
    cases = read_labels(folders.labels, Case.of)
    left = {case.id for case in missing(folders, cases)}
    answer_shown(folders, cases, 2, Console(quiet=True))
    return {name: s for name, s in read_documents(folders, cases)[1].items() if name in left}


def measured(*_):
    return {"decidable": True, "shrink_oracle": 80.0, "bound": {"mass": {"e": 0.005}}}


def tables(answers, statuses=None):
    cases = {one.id: one for one in (MASS, GAIN, CLEAN)}
    ok = {"status": "ok", "cause": "", "seconds": 1.0, "sources": "a" * 64}
    run = {
        "reality": "crazyflow",
        "counts": {"single": 1},
        "seed": None,
        "sha256": "b" * 64,
        "started": "",
        "versions": {},
    }
    return make_tables(
        cases,
        answers,
        {name: (statuses or {}).get(name, ok) for name in cases},
        {MASS.id: measured()},
        {"stlsq": {MASS.id: {"verdict": "none", "effects": []}}},
        run,
    )


def answer(*names, e=0.125):
    interval = {"value": e, "low": e - 0.01, "high": e + 0.01, "unit": "-"}
    effects = [
        {"name": n, "probability": 0.9, "aliases": [], "parameters": {"e": interval}} for n in names
    ]
    return {"verdict": "effect" if effects else "none", "effects": effects}
