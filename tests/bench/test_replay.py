"""Replays: what is stored is what is played; runs are found by name."""

import base64
import json
import re

import numpy as np
import pandas as pd
import pytest
import tables_for_tests
from PIL import Image
from tables_for_tests import Sheet

from bench.cli.app import main
from bench.report import film
from bench.report.flown import GAP, playable, playable_all, positions
from bench.report.replay import write_replay
from bench.store.tables import table
from bench.text.pages import environment, file_name


def frame(pos, t=None):
    """Rows of `trajectories` of one run from positions (time, drones, 3)."""
    times, drones, _ = pos.shape
    t = 0.1 * np.arange(times) if t is None else t
    rows = pd.DataFrame(
        {"run": "a", "drone": np.tile(np.arange(drones), times), "t": np.repeat(t, drones)}
    )
    return rows.assign(**{f"pos_{axis}": pos[..., i].ravel() for i, axis in enumerate("xyz")})


def decode(flight):
    """Positions as replay.js reads them."""
    steps = np.frombuffer(base64.b64decode(flight["xyz"]), "<i2")
    pos = np.where(steps == GAP, np.nan, steps * flight["unit"])
    return pos.reshape(len(flight["t"]), len(flight["drones"]), 3)


def test_a_page_plays_the_stored_positions_to_the_millimetre():
    pos = np.random.default_rng(0).uniform(-5, 5, (40, 3, 3))
    flight = playable(frame(pos).sample(frac=1, random_state=0))  # whatever the order of the rows
    np.testing.assert_allclose(decode(flight), pos, atol=0.5001e-3)
    np.testing.assert_allclose(flight["t"], 0.1 * np.arange(40))


def test_gaps_and_lost_drones_are_gaps_and_far_flights_keep_their_shape():
    pos = np.random.default_rng(1).uniform(-300, 300, (10, 2, 3))
    pos[3, 0], pos[4, 1, 2], pos[5, 0, 0] = np.nan, np.inf, 1e12
    played = decode(playable(frame(pos).drop(index=12)))  # drone 0 at the seventh time
    gaps = np.isnan(played).all(axis=-1)
    assert {tuple(i) for i in np.argwhere(gaps)} == {(3, 0), (4, 1), (5, 0), (6, 0)}
    np.testing.assert_allclose(played[~gaps], pos[~gaps], atol=0.006)


def test_many_flights_are_thinned_alike_and_keep_their_end(monkeypatch):
    monkeypatch.setattr("bench.report.flown.MAX_SAMPLES", 100)
    flights = {name: frame(np.zeros((50, 2, 3))) for name in "ab"}
    thinned = playable_all(flights)
    assert {len(flight["t"]) for flight in thinned.values()} == {26}
    assert thinned["a"]["t"][-1] == pytest.approx(4.9)


def test_a_run_without_samples_has_no_flight():
    assert playable(table("trajectories", [])) is None


def test_the_page_holds_the_flight_and_says_what_ran(tmp_path):
    tables = tables_for_tests.typical()
    write_replay(tables, "run000", tmp_path / "replay.html")
    text = (tmp_path / "replay.html").read_text(encoding="utf-8")
    data = json.loads(
        re.search(r'<script type="application/json" id="flown">(.*?)</script>', text)[1]
    )
    rows = tables.trajectories.query("run == 'run000'")
    np.testing.assert_allclose(decode(data), positions(rows)[2], atol=0.5001e-3)
    assert "lf_baseline" in text
    assert "default-src &#39;none&#39;" in text or "default-src 'none'" in text


def test_a_hostile_run_is_harmless_in_page_and_file_name(tmp_path, monkeypatch):
    name = "</script><script>alert(1)</script>/../../x"
    sheet = Sheet().add("<b>bold</b>", drawn=True)
    for rows in (sheet.results, sheet.runs, sheet.curves, sheet.trajectories):
        for row in rows:
            row["run"] = name
    sheet.tables().save(tmp_path / "tables")
    page = tmp_path / "page.html"
    write_replay(sheet.tables(), name, page)
    text = page.read_text(encoding="utf-8")
    assert "<b>bold" not in text
    assert text.count("</script>") == text.count("<script") == 2
    assert file_name(name) == "_script_script_alert_1_script_.._.._x"


@pytest.mark.parametrize(
    ("text", "name"),
    [("hybrid-mlp-n3", "hybrid-mlp-n3"), ("../../etc", "_.._etc"), ("", "_"), ("a\0b\nc", "a_b_c")],
)
def test_file_names_stay_in_their_folder(text, name):
    assert file_name(text) == name


def test_json_in_a_page_cannot_end_its_script():
    template = environment().from_string("{{ value | tojson }}")
    text = template.render(value={"b": 1, "a": "</script><!--"})
    assert "<" not in text
    assert [*json.loads(text).items()] == [("b", 1), ("a", "</script><!--")]
    with pytest.raises(ValueError, match="JSON"):
        template.render(value={"a": float("nan")})


def test_templates_escape_what_they_show():
    template = environment().from_string("{{ name }}")
    assert template.render(name="<script>") == "&lt;script&gt;"


@pytest.fixture
def saved(tmp_path, monkeypatch):
    """Tables under results/mine of the working directory."""
    monkeypatch.chdir(tmp_path)
    tables_for_tests.typical().save(tmp_path / "results" / "mine")
    return tmp_path


def test_a_run_is_found_by_name_and_its_page_lies_among_the_documents(saved, capsys):
    assert main(["replay", "run000"]) == 0
    assert (saved / "reports" / "mine" / "replays" / "run000.html").is_file()
    assert "reports/mine/replays/run000.html" in capsys.readouterr().out


def test_a_damaged_folder_hides_no_run_of_another(saved, capsys):
    damaged = saved / "results" / "a"
    damaged.mkdir()
    (damaged / "runs.parquet").write_bytes(b"no table")
    assert main(["replay", "run000"]) == 0
    assert main(["replay", "run999"]) == 2
    assert "results/a" in capsys.readouterr().err


def test_a_run_is_found_by_its_folder(saved, capsys):
    assert main(["replay", "results/mine/runs/run000", "--out", "page.html"]) == 0
    assert (saved / "page.html").is_file()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run00"], "hold no run 'run00'. Did you mean 'run0"),
        (["run010"], "no flight of run 'run010'"),
        (["run014"], "no flight of run 'run014'. It ended as 'failed': out of memory"),
        (["run000", "--video", "film.mp4"], "must end in .gif, .png, .webp"),
        (["run000", "--tables", "elsewhere"], "holds no results.parquet"),
        (["elsewhere/runs/run000"], "No tables were found"),
    ],
)
def test_a_replay_that_cannot_be_made_says_why(saved, capsys, arguments, message):
    assert main(["replay", *arguments]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert re.search(message, err)
    assert not (saved / "reports").exists()


def test_a_film_shows_the_drones(tmp_path):
    pos = np.zeros((3, 2, 3))
    pos[:, 1, 0], pos[:, :, 2] = 1.0, 1.0
    pos[:, 0, 1] = [0.0, 0.1, 0.2]
    film.write_film(np.array([0.0, 0.1, 0.2]), pos, tmp_path / "film.gif")
    with Image.open(tmp_path / "film.gif") as picture:
        assert picture.n_frames == 1 + round(0.2 * film.FPS)
        pixels = np.asarray(picture.convert("RGB")).astype(int)
    orange = (pixels[..., 0] > pixels[..., 2] + 60).sum()
    blue = (pixels[..., 2] > pixels[..., 0] + 60).sum()
    assert pixels.shape == (480, 640, 3)
    assert min(orange, blue) > 50
