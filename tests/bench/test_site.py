"""The site: every link leads somewhere, each number to its run, from a file and from a server."""

import functools
import http.server
import json
import re
import threading
import urllib.parse

import diagnoses_for_tests
import pytest
import tables_for_tests
from browser import needs_axe, needs_chromium, tab
from html_for_tests import Page
from rich.console import Console
from tables_for_tests import Sheet

from bench.cli.app import main
from bench.diagnosis_report.documents import write_documents
from bench.report.replay import write_replay
from bench.site.build import build_site

PIXEL = bytes.fromhex(
    "89504e470d0a1a0a0000000d4948445200000001000000010802000000907753de0000000c49444154789c63f8cf"
    "c0000003010100c9fe92ef0000000049454e44ae426082"
)
"""A PNG of one pixel."""


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """Folders of results and reports with something of everything."""
    place = tmp_path_factory.mktemp("world")
    results, reports = place / "results", place / "reports"
    tables = tables_for_tests.typical()
    tables.save(results / "paper")
    Sheet().add(drawn=True).tables().save(results / "mine")
    (results / "broken").mkdir()
    (results / "broken" / "runs.parquet").write_text("no table")
    write_documents(
        diagnoses_for_tests.load(diagnoses_for_tests.effect()), reports / "diagnosis" / "heavy"
    )
    (reports / "bad").mkdir()
    (reports / "bad" / "diagnosis.json").write_text("{}")
    (reports / "blind").mkdir()
    (reports / "blind" / "aims.png").write_bytes(PIXEL)
    (reports / "paper.md").write_text("# Claims & `code`\n\nSee [the laboratory](blind.md#aims).\n")
    (reports / "blind.md").write_text(
        "# Blind\n\n![Aims](blind/aims.png)\n\n<script>alert(1)</script>\n\n"
        "[source](../tests/x.py), [paper](paper.md), [out](https://example.org)\n"
    )
    (reports / "blind_notes.md").write_text("part of another page")
    (results / "paper.md").write_text("# The same name, in the other folder\n")
    (reports / "latin.md").write_bytes("# Größe\n".encode("latin-1"))
    write_replay(tables, tables.trajectories["run"].iloc[0], reports / "paper" / "replays/a.html")
    return results, reports


@pytest.fixture(scope="module")
def site(world, tmp_path_factory):
    """The folder of the site, and what was said while it was built."""
    out, console = tmp_path_factory.mktemp("site"), Console(record=True, width=300)
    index = build_site(*world, out, console)
    assert index == out / "index.html"
    return out, console.export_text()


def pages_of(out):
    return {path: Page(path.read_text(encoding="utf-8")) for path in out.rglob("*.html")}


def test_every_link_of_every_page_leads_somewhere(site):
    pages = pages_of(site[0])
    assert len(pages) == 1 + 2 + 3 + 1 + 1  # index, suites, documents, diagnosis, replay
    followed = 0
    for path, page in pages.items():
        for link in (a["href"] for a in page.all("a") if "href" in a):
            name, _, part = link.partition("#")
            if link == "https://example.org":
                continue
            assert ":" not in name
            target = (path.parent / urllib.parse.unquote(name)).resolve() if name else path
            assert target in pages, (path, link)
            if part and "=" not in part and name != "blind.html":
                assert part in pages[target].ids, (path, link)
            followed += 1
    assert followed > 40


def test_a_number_of_the_index_leads_to_a_run_behind_it(site):
    index = (site[0] / "index.html").read_text()
    found = re.findall(
        r'text">([^<]+)</td><td><a href="suites/(\w+).html#run-(\d+)">([^<]+)</a>', index
    )
    assert [(name, suite) for name, suite, *_ in found][-1] == ("lf_baseline", "mine")
    assert len(found) == 3
    for method, suite, run, number in found:
        page = (site[0] / "suites" / f"{suite}.html").read_text()
        details = json.loads(re.search(r'id="details">(.*?)</script>', page)[1])
        one = details[int(run)]
        assert one["method"] == method
        means = [
            float({m: v for m, v, _ in details[i]["metrics"]}["settled_reward"])
            for i in one["seeds"]
        ]
        shown = float(number.split()[0])
        assert sum(means) / len(means) == pytest.approx(shown, abs=0.5)
    assert "upper_reference" not in index  # it competes with nobody


def test_what_cannot_be_read_is_named_and_left_out(site):
    said = site[1]
    assert "broken" in said
    assert "bad/diagnosis.json is no diagnosis" in said
    assert "latin.md cannot be read" in said
    assert said.count("Warning: Left out") == 3


def test_documents_of_like_names_have_pages_of_their_own(site):
    pages = [(site[0] / "documents" / f"{name}.html").read_text() for name in ("paper", "paper-2")]
    assert "Claims" in pages[0]
    assert "in the other folder" in pages[1]


def test_a_document_is_complete_and_links_within_the_site(site):
    text = (site[0] / "documents" / "blind.html").read_text()
    assert 'src="data:image/png;base64,' in text
    assert "<script>alert" not in text
    assert 'href="paper.html"' in text
    assert "tests/x.py" not in text  # no part of the site
    claims = (site[0] / "documents" / "paper.html").read_text()
    assert 'href="blind.html#aims"' in claims
    assert not (site[0] / "documents" / "blind_notes.html").exists()


def test_the_index_says_what_each_suite_and_diagnosis_found(site):
    index = Page((site[0] / "index.html").read_text(encoding="utf-8"))
    assert "The paper's grid" in index.text
    assert "Claims & code" in index.text
    assert "N = 3 (spread): without high-fidelity flight" in index.text
    assert "These flights are explained by 12.0" in index.text
    assert index.text.index("paper") < index.text.index("mine")


def test_the_command_writes_the_site_and_refuses_what_it_cannot_do(world, tmp_path, capsys):
    results, reports = world
    given = ["--results", str(results), "--reports", str(reports)]
    assert main(["site", str(tmp_path / "out"), *given]) == 0
    assert (tmp_path / "out" / "index.html").is_file()
    assert main(["site", str(reports), *given]) == 2
    assert "a folder of its own" in capsys.readouterr().err
    empty = ["--results", str(tmp_path / "a"), "--reports", str(tmp_path / "b")]
    assert main(["site", str(tmp_path / "out"), *empty]) == 2
    assert "holds tables, documents or diagnoses" in capsys.readouterr().err


@needs_chromium
@pytest.mark.parametrize("served", [False, True])
def test_the_site_opens_from_a_file_and_from_a_server(site, tmp_path, served):
    handler = functools.partial(Quiet, directory=str(site[0]))
    with (
        http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server,
        tab(tmp_path / "profile") as opened,
    ):
        threading.Thread(target=server.serve_forever, daemon=True).start()
        start = f"http://127.0.0.1:{server.server_port}/" if served else site[0].as_uri() + "/"
        opened.go(start + "index.html")
        opened.run("document.querySelector('a[href*=\"#run-\"]').click()")
        opened.wait_for("document.getElementById('run')?.open")
        assert opened.run("location.href").startswith(f"{start}suites/paper.html#run-")
        opened.go(start + "index.html")
        opened.run("document.querySelector('a[href*=\"task=\"]').click()")
        # A page that is still being read may show three rows of the unfiltered table.
        opened.wait_for("document.getElementById('filters')?.elements.task.value === 'circle'")
        opened.wait_for("document.querySelector('table.board').tBodies[0].rows.length === 3")
        assert opened.complaints == []
        server.shutdown()


@needs_chromium
@needs_axe
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_no_violation_in_the_site(site, tmp_path, scheme):
    with tab(tmp_path / "profile") as opened:
        opened.prefer(scheme)
        for name in ("index.html", "documents/blind.html"):
            opened.open(site[0] / name, width=390)
            assert opened.violations() == []
            assert opened.run("document.documentElement.scrollWidth") == 390


class Quiet(http.server.SimpleHTTPRequestHandler):
    """A server that writes no log."""

    def log_message(self, *_):
        pass
