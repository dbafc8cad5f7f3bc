"""CITATION.cff and the container: what they say is true of the project."""

import re
import tomllib
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
DOCKERFILE = (ROOT / "Dockerfile").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def project():
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_the_citation_has_what_its_format_requires_and_the_version_of_the_project(project):
    """Required by the schema of the Citation File Format 1.2.0: these four keys, named authors."""
    found = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert found.keys() >= {"cff-version", "message", "title", "authors"}
    assert (found["cff-version"], found["type"]) == ("1.2.0", "software")
    assert (str(found["version"]), found["license"]) == (project["version"], project["license"])
    for work in (found, *found["references"]):
        assert work["title"]
        for author in work["authors"]:
            assert author.keys() == {"name"} or author.keys() >= {"given-names", "family-names"}
    (paper,) = found["references"]
    assert paper["type"] == "article"
    assert paper["identifiers"][0]["value"] == "arXiv:2609.17265"
    assert paper["identifiers"][0]["value"].removeprefix("arXiv:") in (
        (ROOT / "README.md").read_text(encoding="utf-8")
    )


def test_the_container_installs_as_we_do_and_runs_the_quick_suite(project):
    assert re.search(r'^CMD \["make", "run"\]$', DOCKERFILE, re.MULTILINE)
    targets = re.findall(r"^(\S+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert "run" in targets
    assert "make .venv/.ready" in DOCKERFILE
    minimum = project["requires-python"].removeprefix(">=")
    assert f"ARG PYTHON={minimum}\n" in DOCKERFILE


def test_the_variants_of_the_container_are_cpu_and_cuda():
    assert "\nARG VARIANT=cpu\n" in DOCKERFILE
    assert "cpu|cuda) ;;" in DOCKERFILE
    assert "-c constraints.txt 'jax[cuda12]'" in DOCKERFILE


def test_the_image_has_all_that_is_installed_and_nothing_that_was_built():
    lines = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    ignored = {line for line in lines if line and not line.startswith("#")}
    assert {".venv", "results/quick", "reports/quick", "results/*/runs"} <= ignored
    needed = {".git", "Makefile", "constraints.txt", "pyproject.toml", "README.md", "LICENSE"}
    needed |= {"bench", "blind", "diagnosis", "methods", "simulators", "tasks"}
    assert not needed & ignored
    assert all((ROOT / name).exists() for name in needed - {".git"})
