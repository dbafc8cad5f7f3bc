"""Truncated, empty and hostile files give one line, and leave nothing behind."""

import gc
import sys

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from import_logs_for_tests import VEHICLE, WEIGHT, circle, write_log
from log_tables import examples
from log_writers import variables, write_cflib, write_usd

from diagnosis.importing.convert import READERS, import_logs
from diagnosis.logs.columns import LogError
from diagnosis.logs.flights import load_flights

FULL = 2.0 * WEIGHT
INSIDE = {"mcap": "*.mcap", "ros2": "*.db3"}
"""The file of a bag that is a folder."""


@pytest.fixture(scope="module", autouse=True)
def _others_are_no_garbage():
    """A bad file makes its reader collect all garbage; what was there before is left out."""
    gc.freeze()
    yield
    gc.unfreeze()


def written(kind, folder, log):
    """A good file of a format; skips where its package is missing."""
    file = write_log(kind, folder, log, WEIGHT, 0.48)
    return next(file.glob(INSIDE[kind])) if kind in INSIDE else file


@pytest.fixture(scope="module", params=["ulog", "ardupilot", "ros1", "mcap", "ros2", "usd"])
def source(request, tmp_path_factory):
    """A good file of each format, two seconds."""
    return written(request.param, tmp_path_factory.mktemp("good"), circle(seconds=2.0))


def put(tmp_path_factory, source, data):
    folder = tmp_path_factory.mktemp("bad")
    (folder / source.name).write_bytes(data)
    return folder / source.name


def why_not(file, **options):
    """The one line that says why nothing is imported; nothing is left behind."""
    out = file.parent / "deeper" / "out"
    before = sorted(file.parent.rglob("*"))
    with pytest.raises(LogError) as caught:
        import_logs([file], out, VEHICLE, full_thrust=FULL, **options)
    assert sorted(file.parent.rglob("*")) == before
    assert "\n" not in str(caught.value)
    assert file.name in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("share", [0.0005, 0.01, 0.3, 0.8])
def test_a_truncated_file_gives_one_line(source, tmp_path_factory, capfd, share):
    data = source.read_bytes()
    size = int(len(data) * share)
    if source.suffix == ".ulg":
        size = size if not _at_a_message(data, size) else size + 1
    why_not(put(tmp_path_factory, source, data[:size]))
    assert capfd.readouterr() == ("", "")


def _at_a_message(data, size):
    """Whether a ULog file cut to that size ends with a whole message, so that nobody can tell."""
    at = 16
    while at < size:
        at += 3 + int.from_bytes(data[at : at + 2], "little")
    return at == size


def test_an_empty_file_is_named(tmp_path):
    file = tmp_path / "a.ulg"
    file.write_bytes(b"")
    assert "the file is empty (0 bytes)" in why_not(file)


damaged = given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 40), early=st.booleans())


@examples(8)
@damaged
def test_damaged_bytes_never_do_more_than_one_line(source, tmp_path_factory, seed, count, early):
    one_line_at_most(source, tmp_path_factory, seed, count, early)


@pytest.mark.exhaustive  # the same with more examples
@examples(100)
@damaged
def test_no_damaged_bytes_of_many_do(source, tmp_path_factory, seed, count, early):
    one_line_at_most(source, tmp_path_factory, seed, count, early)


def one_line_at_most(source, tmp_path_factory, seed, count, early):
    """Any exception but LogError, and any warning, fails the test."""
    rng, data = np.random.default_rng(seed), bytearray(source.read_bytes())
    for at in rng.integers(0, min(len(data), 2000) if early else len(data), count):
        data[at] = rng.integers(256)
    file = put(tmp_path_factory, source, bytes(data))
    out = file.parent / "out"
    try:
        import_logs([file], out, VEHICLE, full_thrust=FULL)
    except LogError as error:
        said = str(error)
    else:
        said = ""
    assert "\n" not in said
    assert out.exists() == (said == "")
    assert not out.exists() or load_flights(out).flights
    assert not list(file.parent.glob(".out*"))


@pytest.mark.parametrize("kind", ["ulog", "ardupilot", "usd"])
def test_a_log_that_breaks_off_is_used_where_the_operator_says_so(tmp_path, kind):
    file = written(kind, tmp_path, circle(seconds=4.0))
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2 + 1])
    assert "or use what comes before with --truncated" in why_not(file)
    found = import_logs([file], tmp_path / "out", VEHICLE, truncated=True)
    (flight,) = load_flights(tmp_path / "out").flights
    assert 1.8 < flight.seconds < 2.1
    assert any("what comes before is used" in note for note in found.flights[0].notes)


def test_erased_memory_at_the_end_of_a_dataflash_log_is_no_damage(tmp_path):
    file = written("ardupilot", tmp_path, circle(seconds=2.0))
    file.write_bytes(file.read_bytes() + b"\xff" * 200)
    assert import_logs([file], tmp_path / "out", VEHICLE).flights


@pytest.mark.parametrize("kind", ["ulog", "ros", "ardupilot", "usd", "cflib"])
def test_a_file_of_another_kind_gives_one_line(tmp_path, kind):
    if kind in ("ulog", "ros", "ardupilot"):
        package = READERS[kind].package
        pytest.importorskip(package, reason=f"{package} is not installed")
    file = tmp_path / "notes.bin"
    file.write_bytes(b"Nothing of this is a log.\n" * 500)
    assert "of no known format (" in why_not(file)
    why_not(file, kind=kind)


def test_one_bad_log_stops_no_other(tmp_path):
    good = write_usd(tmp_path / "log00", circle(), 0.48)
    bad = tmp_path / "log01"
    bad.write_bytes(good.read_bytes()[:-9])
    found = import_logs([good, bad], tmp_path / "out", VEHICLE)
    assert [flight.name for flight in found.flights] == ["log00"]
    (left,) = found.left_out
    assert "checksum does not match" in left.reason
    assert "checksum does not match" in (tmp_path / "out" / "import.md").read_text()


def test_a_flight_that_the_diagnosis_would_not_take_is_left_out(tmp_path):
    """Here the operator gives a thrust scale ten times too large."""
    file = write_usd(tmp_path / "log00", circle(), 0.48)
    with pytest.raises(LogError, match=r"^log00: column 'cmd_thrust': the median of what is"):
        import_logs([file], tmp_path / "out", VEHICLE, full_thrust=4.8)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["log00"]


def test_a_folder_that_is_there_is_not_touched(tmp_path):
    file = write_usd(tmp_path / "log00", circle(), 0.48)
    (tmp_path / "out").mkdir()
    import_logs([file], tmp_path / "out", VEHICLE)
    before = (tmp_path / "out" / "import.md").read_bytes()
    with pytest.raises(LogError, match="is there already; a new or an empty folder"):
        import_logs([file], tmp_path / "out", VEHICLE)
    assert (tmp_path / "out" / "import.md").read_bytes() == before


def test_a_package_that_is_missing_is_named(tmp_path, monkeypatch):
    file = tmp_path / "a.ulg"
    file.write_bytes(b"ULog\x01\x12\x35\x01" + bytes(40))
    monkeypatch.setitem(sys.modules, "pyulog", None)
    got = why_not(file)
    assert "'pyulog', which is not installed" in got
    assert "pip install 'fidelity-bench[ulog]'" in got


def test_blocks_of_one_flight_may_lack_rows(tmp_path):
    """cfclient writes a file a block; a row that is cut in one of them is named."""
    folder = write_cflib(tmp_path / "session", circle(), 0.48)
    assert import_logs([folder], tmp_path / "out", VEHICLE).flights
    block = folder / "pos-20261123.csv"
    block.write_text(block.read_text()[:-30])
    with pytest.raises(LogError, match=r"session: pos-20261123\.csv: .*(cut|text)"):
        import_logs([folder], tmp_path / "out2", VEHICLE)
    whole, _, last = block.read_text().rstrip().rpartition("\n")
    block.write_text(f"{whole}\n{last.partition(',')[0]},0.1\n")
    with pytest.raises(LogError, match=r"the last row is cut; copy .* --truncated"):
        import_logs([folder], tmp_path / "out2", VEHICLE)
    assert import_logs([folder], tmp_path / "out2", VEHICLE, truncated=True).flights


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("late,1,2,3,4,5,6", "column 'Timestamp' holds text; numbers are expected"),
        (",1,2,3,4,5,6", "a row has no time"),
        ("99000,1,2", "the last row is cut"),
        ("99000,1,2,3,4,5,6,7,8", "this is no whole CSV file: ParserError"),
    ],
)
def test_a_bad_row_of_a_csv_is_named(tmp_path, row, message):
    folder = write_cflib(tmp_path / "session", circle(), 0.48)
    with (folder / "pos-20261123.csv").open("a") as file:
        file.write(row + "\n")
    assert message in why_not(folder)


def test_a_crazyflie_without_any_attitude_gives_one_line(tmp_path):
    """Mellinger's controller commands an axis; its yaw is that of the measured attitude."""
    log = circle()
    columns = {n: v for n, v in variables(log, 0.48).items() if not n.startswith("controller")}
    columns |= {f"stateEstimate.q{n}": 0.0 * log.t for n in "xyzw"}
    columns |= {"ctrlMel.zdx": 0.0 * log.t, "ctrlMel.zdy": 0.0 * log.t, "ctrlMel.zdz": log.t + 1.0}
    file = tmp_path / "mellinger.csv"
    pd.DataFrame({"Timestamp": 1e3 * log.t, **columns}).to_csv(file, index=False)
    why_not(file)


def test_a_ulog_message_that_claims_to_be_longer_than_the_file_ends(tmp_path):
    """pyulog goes back and forth in it for ever."""
    pytest.importorskip("pyulog")
    head = b"ULog\x01\x12\x35\x01" + bytes(8)
    file = tmp_path / "long.ulg"
    file.write_bytes(head + bytes(20_000) + b"\x3a\x3a\x01" + bytes(10))
    with pytest.raises(LogError, match=r"long\.ulg"):
        import_logs([file], tmp_path / "out", VEHICLE)
