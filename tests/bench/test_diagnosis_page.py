"""What `bench diagnose` shows: one page that loads nothing, pictures, all files or none."""

import dataclasses
import io
import json
import math
import re

import diagnoses_for_tests
import numpy as np
import pytest
from diagnoses_for_tests import HOSTILE, load
from html_for_tests import Page
from rich.console import Console

from bench.diagnosis_report import figures, tables
from bench.diagnosis_report.documents import NAMES, diagnosis_text, write_documents
from bench.diagnosis_report.gap_text import shrink_sentence
from bench.diagnosis_report.page import diagnosis_page
from bench.diagnosis_report.sentences import LIKENESS, remarks, verdict
from bench.diagnosis_report.terminal import DiagnosisProgress, show_summary
from bench.report.page import render_markdown


@pytest.fixture(scope="module", params=diagnoses_for_tests.ALL)
def kind(request):
    return request.param


@pytest.fixture(scope="module")
def page(kind):
    return Page(diagnosis_page(load(diagnoses_for_tests.ALL[kind]())))


def test_what_left_out_flights_confirm_stands_beside_a_gap_that_is_not_explained():
    found = load(diagnoses_for_tests.partly())
    assert remarks(found)[:2] == [
        f"{LIKENESS} The remaining misfit could bias the sizes, so they are descriptive only. With "
        "the likeliest set in the simulator, its drift from held-out flights over 0.5 s falls "
        "from 34 mm to 6.1 mm.",
        "Flights left out of the fit do not confirm wind.",
    ]
    assert shrink_sentence(found).startswith("With the likeliest set of effects in the simulator")
    table = tables.support_table(found)
    assert table.rows[0] == ("mass", "91.2 %", "89.7 to 92.4 %", "12")
    for text in (diagnosis_text(found), Page(diagnosis_page(found)).text):
        assert "How far the gap shrinks" in text
        assert "89.7 to 92.4 %" in text
        assert "looks like 12.0" in text
        assert "mass, probability" not in text
        assert "wind, in the likeliest set but not blamed" in text
        assert "descriptive" in text
    beside = load(diagnoses_for_tests.reference())
    assert "too sure" in str(tables.candidates_table(beside).notes)
    (row,) = tables.support_table(beside).rows
    assert row == ("thrust gain", tables.MISSING, tables.MISSING, "2")
    assert tables.support_table(load(diagnoses_for_tests.effect())) is None


def test_the_page_beside_a_twin_says_whose_drift_it_shows():
    found = diagnoses_for_tests.partly()
    assert "At each moment the simulator starts" in Page(diagnosis_page(load(found))).text
    lines = [{"channel": "roll", "unit": "rad", "simulator": 0.0333, "twin": 0.0078}]
    found["details"]["followed"] = lines
    found["effects"][0] |= {"aliases": ["thrust_gain"], "probability": 0.58}
    for text in (diagnosis_text(load(found)), Page(diagnosis_page(load(found))).text):
        assert "keeps what it missed before" in text
        assert "mass or thrust gain, probability 0.58 together" in text
    page = Page(diagnosis_page(load(found))).text
    assert "At each moment the twin starts" in page
    assert "with: the likeliest set of effects is in it, too" in page


def test_sizes_stand_with_their_use_and_the_end_of_their_range():
    found = diagnoses_for_tests.effect()
    found["effects"][0]["parameters"][0] |= {"at_bound": "high", "use": "descriptive"}
    diagnosis = load(found)
    (row,) = tables.parameters_table(diagnosis.effects[0]).rows
    assert row[-1] == "descriptive, at the upper end of its range"
    assert remarks(diagnosis)[0].startswith("At the end of its allowed range, and so descriptive")


def test_what_can_be_copied_is_marked_as_code():
    html = diagnosis_page(load(diagnoses_for_tests.effect()))
    assert "<code>diagnosis.corrected(&#34;diagnosis.json&#34;)</code>" in html
    assert "<code>bench diagnose diagnosis.json --remedy crazyflie</code> (or px4" in html
    assert "likeliest=True)</code>" in diagnosis_page(load(diagnoses_for_tests.unexplained()))


def test_page_loads_nothing_and_runs_nothing(page):
    page.check_loads_nothing()
    assert not page.all("script") + page.all("img")
    for _, attributes in page.tags:
        assert not any(key.startswith("on") for key in attributes)
        assert "http" not in "".join(value or "" for value in attributes.values())


def test_hostile_names_are_shown_and_never_markup(page, kind):
    assert not page.all("script")
    assert page.open == []
    if kind not in ("reference", "empty"):
        assert f"Diagnosis of {HOSTILE}" in page.text
    if kind != "empty":
        assert page.text.count("alert(1)") >= 2


def test_everything_that_is_seen_can_be_heard(page):
    figures_ = page.all("figure")
    images = [a for _, a in page.tags if a.get("role") == "img"]
    assert len(images) >= len(figures_)
    assert all(a["aria-label"].strip() for a in images)
    assert all(a.get("aria-hidden") == "true" for a in page.all("svg") if "class" in a)
    assert len(page.all("caption")) == len(page.all("table"))
    assert page.all("html")[0]["lang"] == "en"
    assert len(page.all("h1")) == 1


def test_ids_are_unique_and_every_reference_has_its_target(page):
    ids = set(page.ids)
    assert len(page.ids) == len(ids)
    for _, attributes in page.tags:
        for key in ("href", "xlink:href"):
            if key in attributes:
                assert attributes[key][1:] in ids
        clip = re.search(r"url\(#([^)]*)\)", attributes.get("clip-path", ""))
        assert clip is None or clip[1] in ids


def test_page_has_the_sections_that_its_data_allow(page, kind):
    headings = {a["id"] for a in page.all("h2")}
    explained = kind in ("effect", "pair", "reference", "alias", "partly")
    assert ("shrink" in headings) == explained
    assert {"where", "which", "flights"} <= headings
    assert ("silent" in headings) == ("next" in headings) == (kind != "empty")
    assert bool(page.all("figure")) == (kind != "empty")


def test_page_is_small():
    found = diagnoses_for_tests.effect()
    t = [0.01 * i for i in range(20_000)]
    flight = {"flight": "long", "t": t, "before": t, "after": t}
    found["details"]["before_after"] = [flight] * 30
    text = diagnosis_page(load(found))
    assert len(text.encode()) < 1e6
    assert "24 more held-out flights" in text


def test_pictures_follow_the_colours_of_the_page():
    (_, panels), *_ = figures.regime_panels(load(diagnoses_for_tests.effect()))
    assert [panel.title for panel in panels] == ["by speed", "by tilt", "by thrust"]
    for panel in panels:
        assert "var(--before)" in panel.svg
        assert not set(re.findall(r"#[0-9a-f]{6}\b", panel.svg)) - {"#000000"}


def test_picture_in_time_marks_the_onset_in_its_place():
    (panel,) = figures.time_panels(load(diagnoses_for_tests.unexplained()))
    assert "sets in at 4.2 s" in panel.svg
    (panel,) = figures.time_panels(load(diagnoses_for_tests.effect()))
    assert "sets in" not in panel.svg


def test_labels_from_logs_are_text_in_pictures_too():
    found = diagnoses_for_tests.effect()
    found["where"][2]["regimes"][0] |= {"variable": "<b>$x_1$</b>\x00", "unit": "<i>"}
    (_, panels), *_ = figures.regime_panels(load(found))
    assert "<b>" not in panels[0].svg
    assert "&lt;b&gt;$x_1$&lt;/b&gt; [&lt;i&gt;]" in panels[0].svg


def test_a_gap_in_the_log_is_a_gap_in_the_line():
    t = np.array([0.0, 0.1, 0.2, 0.3, 2.0, 2.1])
    shown, values = figures._thinned(t, t + 1.0)
    assert np.isnan(values[4])
    assert np.isnan(shown[4])
    assert np.array_equal(values[~np.isnan(values)], t + 1.0)


def test_bars_are_in_proportion_to_the_noise_floor():
    found = diagnoses_for_tests.effect()
    shown = tables.where_table(load(found))
    assert shown.rows[0][0] == "specific force z"
    by_name = {row[0]: bar for row, bar in zip(shown.rows, shown.bars, strict=True)}
    force, drift = by_name["specific force z"], by_name["position drift z"]
    assert force.length / drift.length == pytest.approx((1.32 / 0.16) / (0.033 / 0.003))
    assert force.length / force.mark == pytest.approx(1.32 / 0.16)
    assert drift.high == 1.0
    assert force.chosen
    assert not by_name["attitude pitch"].chosen  # 0.9 of its gap lies below the noise floor
    assert not by_name["attitude roll"].chosen


def test_what_was_chosen_stands_out_among_the_candidates():
    def coloured(kind):
        shown = tables.candidates_table(load(diagnoses_for_tests.ALL[kind]()))
        return [row[0] for row, bar in zip(shown.rows, shown.bars, strict=True) if bar.chosen]

    assert coloured("effect") == ["mass"]
    assert coloured("pair") == ["delay + wind"]
    assert coloured("none") == ["no effect"]
    assert coloured("unexplained") == []


def test_what_every_candidate_was_tried_beside_is_said_where_it_is_not_blamed():
    content = diagnoses_for_tests.beside_twin(diagnoses_for_tests.effect())
    for one in content["candidates"]:
        one["effects"] = [*one["effects"], "motor_lag"]
    notes = tables.candidates_table(load(content)).notes
    assert "Each was tried beside motor lag, which the verdict does not blame." in notes
    plain = tables.candidates_table(load(diagnoses_for_tests.effect()))
    assert not any("tried beside" in note for note in plain.notes)


def test_tables_show_people_the_units_that_people_use():
    found = load(diagnoses_for_tests.reference())
    assert tables.shared_table(found).rows[1] == (
        "trim",
        "right side down",
        "0.831°",
    )
    limits = {row[0]: row[2] for row in tables.limits_table(found).rows}
    assert limits == {"mass": "1.1 %", "attitude lag": "4.2 ms", "linear drag": "-"}


def test_markdown_says_the_same_and_keeps_hostile_names_apart(kind):
    found = load(diagnoses_for_tests.ALL[kind]())
    text = diagnosis_text(found)
    rendered = Page(str(render_markdown(text)))
    assert rendered.open == []
    assert not rendered.all("script")
    assert verdict(found) in rendered.text
    if kind != "empty":
        assert "bad|one" in rendered.text
        assert "column `pos_x`, row 12: NaN" in rendered.text
    for line in text.splitlines():
        assert "None" not in line
        assert "nan" not in line.lower().replace("row 12: nan", "")


def test_summary_on_the_terminal_is_short_and_obeys_no_name(kind, tmp_path):
    console = Console(file=io.StringIO(), width=100, force_terminal=True, color_system="standard")
    found = load(diagnoses_for_tests.ALL[kind]())
    name = "\x1b]0;title\x07[red]flights[/red]"
    found = dataclasses.replace(found, flights=dataclasses.replace(found.flights, name=name))
    show_summary(found, tmp_path, console)
    text = console.file.getvalue()
    assert "\x1b]0;" not in text
    assert "[red]flights[/red]" in text
    assert "diagnosis.html" in text
    assert len(text.splitlines()) < 30


def test_progress_is_a_line_per_stage_where_there_is_no_terminal():
    console = Console(file=io.StringIO(), width=80)
    with DiagnosisProgress(console) as display:
        for stage, fraction in [("replay", 0.0), ("replay", 0.2), ("[b]fit", 0.5), ("[b]fit", 2.0)]:
            display.update(stage, fraction)
    assert console.file.getvalue() == "replay\n[b]fit\n"


def test_documents_are_written_together_and_json_keeps_the_schema(tmp_path):
    content = diagnoses_for_tests.effect()
    found = load(content)
    limit = dataclasses.replace(found.details.limits[0], smallest=math.inf)
    details = dataclasses.replace(found.details, limits=(limit,))
    write_documents(dataclasses.replace(found, details=details), tmp_path / "new" / "place")
    place = tmp_path / "new" / "place"
    assert sorted(p.name for p in place.iterdir()) == sorted(NAMES)
    read = json.loads((place / "diagnosis.json").read_text(encoding="utf-8"))
    content["details"]["limits"] = [content["details"]["limits"][0] | {"smallest": None}]
    assert read == content | {"untold": []}


def test_a_failure_while_writing_leaves_what_was_there(tmp_path, monkeypatch):
    write_documents(load(diagnoses_for_tests.effect()), tmp_path)
    kept = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    monkeypatch.setattr("os.fsync", lambda _: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        write_documents(load(diagnoses_for_tests.none()), tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == kept


def test_noise_has_units():
    rows = {row[0]: row[1] for row in tables.noise_table(load(diagnoses_for_tests.effect())).rows}
    assert rows["position x"].endswith("mm")
    assert rows["velocity z"].endswith("m/s")
    assert rows["attitude roll"] == tables.MISSING
