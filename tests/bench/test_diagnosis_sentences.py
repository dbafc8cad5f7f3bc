"""What a diagnosis says in sentences, and the numbers in them: kept texts, a case each.

`python tests/bench/test_diagnosis_sentences.py` writes the kept texts again.
"""

import sys
from pathlib import Path

import pytest
from diagnoses_for_tests import (
    alias,
    beside_twin,
    channel,
    effect,
    empty,
    load,
    none,
    pair,
    parameter,
    partly,
    reference,
    unexplained,
)

from bench.diagnosis_report.effect_words import effect_phrase
from bench.diagnosis_report.gap_text import expected, shrink_sentence, where_sentence
from bench.diagnosis_report.remedy import remedy
from bench.diagnosis_report.sentences import (
    kind_label,
    next_flight,
    remarks,
    verdict,
)
from bench.diagnosis_report.tables import candidates_table, effect_heading, facts, parameters_table
from bench.text.words import clean
from diagnosis.result import Effect, Parameter
from simulators import registry
from simulators.effects.card import load_card, load_cards

KEPT = Path(__file__).parent / "kept" / "sentences.md"
LEFT_OUT = "Left out"
"""How remarks on what was left out begin."""
PARTS = {
    "kind": kind_label,
    "verdict": verdict,
    "remark": lambda found: [line for line in remarks(found) if not line.startswith(LEFT_OUT)],
    "left_out": lambda found: [line for line in remarks(found) if line.startswith(LEFT_OUT)],
    "remedy": remedy,
    "next": next_flight,
    "where": where_sentence,
    "shrink": shrink_sentence,
    "expected": expected,
    "fact": lambda found: [", ".join(line) for line in facts(found)],
    "heading": lambda found: [effect_heading(found, one) for one in found.effects],
    "candidates": lambda found: candidates_table(found).notes,
    "size": lambda found: [" | ".join(row) for row in parameters_table(found.effects[0]).rows],
}
"""What is written of a case."""


def changed(found, *place, **values):
    """A diagnosis with other values in one of its objects: itself, or what `place` leads to."""
    part = found
    for key in place:
        part = part[key]
    part |= values
    return found


def sized(found, *sizes, name="mass", **values):
    """A diagnosis whose first effect has this name and these sizes."""
    return changed(found, "effects", 0, name=name, parameters=[*sizes], **values)


def at_end(found, end):
    size = parameter("e", 0.12, None, None, "-", "descriptive") | {"at_bound": end}
    return sized(found, size)


def unblamed(found):
    return found | {"effects": [one | {"blamed": False} for one in found["effects"]]}


def followed(found, *lines):
    keys = ("channel", "unit", "simulator", "twin")
    lines = [dict(zip(keys, line, strict=True)) for line in lines]
    return changed(found, "details", followed=lines)


def remaining(found, *channels):
    """A gap of which so much is left: channel, share, main, beyond noise."""
    where = [
        channel(name, "rad", 0.1, 0.01, share, main) | {"beyond_noise": beyond}
        for name, share, main, beyond in channels
    ]
    return changed(found, "remainder", where=where)


def beyond_noise(found, *channels):
    for line in found["where"]:
        line["beyond_noise"] = line["channel"] in channels
    return found


def likeliest():
    """A gap that is not explained, with two effects in the likeliest set."""
    return partly() | {"verdict": "unexplained", "effects": unexplained()["effects"]}


YAW, PITCH = ("yaw", 0.62, True, False), ("pitch", 0.15, False, True)
"""The largest remainder, within its noise, and a smaller one beyond it."""
ROLL, UP = ("roll", "rad", 0.0333, 0.0078), ("acceleration up", "m/s^2", 0.56, 0.09)
MORE = parameter("e", 0.2, 0.15, 0.25, "-")
FLIP = {
    "part": "frame of the path",
    "readings": ["y flipped"],
    "advice": "Check y.",
    "evidence": [],
}
TURN = {"part": "heading", "readings": ["turned"], "advice": "Check.", "evidence": []}
CLASS = {"aliases": ["thrust_gain", "battery"], "probability": 0.99}
TRIM = (
    parameter("roll", -0.0186, None, None, "rad"),
    parameter("pitch", 0.0489, None, None, "rad"),
)
TOO_FEW, UNKNOWN = {"verdict": "too_few"}, {"verdict": "unexplained", "probability": None}
SMALL_REST = {"share": 0.05, "mostly_explained": True}
GROWN = {"after": 0.05, "percent": -46.0, "low": -60.0, "high": -30.0}

CASES = {
    "an effect": (effect(), "kind verdict remark shrink fact"),
    "two effects": (pair(), "verdict remark left_out"),
    "no effect": (none(), "verdict remark where"),
    "no cause": (unexplained(), "kind verdict fact"),
    "part of a gap": (partly(), "kind verdict remark"),
    "a change since the reference flights": (reference(), "verdict remark"),
    "effects that look alike": (alias(), "kind verdict remedy heading candidates"),
    "no details": (empty(), "verdict"),
    "another probability": (effect() | {"probability": 0.6}, "verdict"),
    "a doubted effect": (effect() | {"doubt": {"structure": 8.9, "true_share": 0.6}}, "remark"),
    "most of a gap": (
        changed(partly(), "remainder", share=0.002, mostly_explained=True),
        "verdict",
    ),
    "part of a gap, with an alternative": (
        changed(partly(), "effects", 0, aliases=["thrust_gain"]),
        "kind verdict",
    ),
    "too few flights": (none() | TOO_FEW, "verdict remedy"),
    "too few flights, with a likeliest change": (
        unblamed(reference() | TOO_FEW),
        "verdict",
    ),
    "a twin that follows the reference flights": (followed(reference(), ROLL, UP), "remark"),
    "an effect beside a twin": (
        beside_twin(effect()),
        "verdict remark remedy shrink expected",
    ),
    "part of a gap beside a twin": (
        beside_twin(partly()),
        "verdict remark remedy shrink expected",
    ),
    "no effect beside a twin": (followed(none(), ROLL), "verdict"),
    "effects that look alike beside a twin share a probability": (
        changed(beside_twin(alias()) | {"probability": 0.99}, "effects", 0, **CLASS),
        "verdict remedy heading candidates",
    ),
    "without an alias no probability is shared": (
        changed(beside_twin(alias()), "effects", 0, aliases=[]),
        "verdict",
    ),
    "mass or thrust gain": (changed(alias(), "effects", 0, aliases=["thrust_gain"]), "verdict"),
    "a battery fades, which thrust over mass does not say": (
        changed(alias(), "effects", 0, aliases=["battery"]),
        "verdict",
    ),
    "more mass, or less thrust": (sized(effect(), MORE, aliases=["thrust_gain"]), "verdict"),
    "more thrust, or less mass": (
        sized(effect(), MORE, name="thrust_gain", aliases=["mass"]),
        "verdict",
    ),
    "an interval that no mass could have": (
        sized(effect(), parameter("e", 0.25, -5.05, 5.23, "-"), aliases=["thrust_gain"]),
        "verdict",
    ),
    "an interval wider than the range": (
        sized(effect(), parameter("e", 0.1203, -5.05, 5.23, "-")),
        "verdict size",
    ),
    **{
        f"{kind.__name__}: a size at the {end} end of its range": (at_end(kind(), end), "remark")
        for kind in (effect, partly)
        for end in ("low", "high")
    },
    "directions are words and not signs": (sized(reference(), *TRIM, name="trim"), "verdict"),
    "part of a gap, the rest is beyond noise": (remaining(partly(), YAW, PITCH), "verdict"),
    "part of a gap, the rest does not stand out": (remaining(partly(), YAW), "verdict"),
    "no cause, the rest is beyond noise": (remaining(likeliest(), YAW, PITCH), "verdict"),
    "no cause, the rest does not stand out": (remaining(likeliest(), YAW), "verdict"),
    "no cause, though a set makes up for the gap": (
        changed(unexplained(), "remainder", **SMALL_REST),
        "kind verdict",
    ),
    "no cause, and nothing was put into the model": (
        changed(unexplained(), "remainder", share=1.0),
        "verdict",
    ),
    "a fault of the logs comes before any physics": (
        unblamed(partly()) | UNKNOWN | {"interface": [FLIP]},
        "kind verdict remark remedy next",
    ),
    "without a fault of the logs a flight follows": (unexplained(), "next"),
    "a fault of the logs where nothing else is wrong": (
        none() | {"interface": [TURN]},
        "kind verdict remedy",
    ),
    "no small change could hide": (changed(none(), "details", limits=[]), "remark"),
    "a gap in a channel that is beyond noise": (
        beyond_noise(effect(), "position drift z"),
        "where",
    ),
    "a gap in channels that do not stand out": (beyond_noise(effect()), "where"),
    "no effect, though a channel stands out": (beyond_noise(none(), "attitude roll"), "where"),
    "too few flights, though a channel stands out": (
        beyond_noise(none() | TOO_FEW, "attitude roll"),
        "where",
    ),
    "drift that grows": (changed(effect(), "shrink", **GROWN), "verdict shrink"),
    "half seconds that count nowhere": (
        changed(effect(), "details", windows={"n": 236, "aside": 3}),
        "shrink",
    ),
}
"""Diagnoses, and which parts of the texts on them are kept."""


def texts():
    """What is said of every case."""
    parts = []
    for case, (found, names) in CASES.items():
        parts.append(f"# {case}\n")
        for name in names.split():
            said = PARTS[name](load(found))
            lines = [said] if isinstance(said, str) else said
            parts += [f"- {name}: {line}".rstrip() for line in lines]
        parts.append("")
    return "\n".join(parts)


def test_every_sentence_is_the_kept_one():
    assert texts() == KEPT.read_text(encoding="utf-8")


def test_names_that_are_no_text_can_be_printed():
    assert clean("\udcfcbung").encode() == "\ufffdbung".encode()


PLAIN = {
    ("attitude_loop", "damping"),
    ("collision", "stiffness"),
    ("collision", "friction"),
    ("downwash", "strength"),
    ("floor", "height"),
    ("gust", "onset"),
}
"""Parameters whose names are words."""


def test_every_registered_effect_and_parameter_has_words():
    for name, kind in registry.load_all("effect").items():
        assert kind.card is not None
        assert kind.card.shown.keys() <= kind.parameters.keys()
        for key in kind.parameters:
            assert (key in kind.card.shown) != ((name, key) in PLAIN)


@pytest.mark.parametrize("name", [*load_cards(), "third_party"])
@pytest.mark.parametrize("value", [-0.2, 0.0, 0.3])
@pytest.mark.parametrize("bounded", [True, False])
def test_every_effect_can_be_told_in_a_sentence(name, value, bounded):
    names = [*load_card(name).shown] or ["p"]
    ends = (value - 0.01, value + 0.01) if bounded else (None, None)
    sizes = tuple(
        Parameter(
            name=p, value=value, low=ends[0], high=ends[1], unit="-", at_bound="no", use="measured"
        )
        for p in names
    )
    effect = Effect(name=name, blamed=True, probability=0.9, aliases=(), parameters=sizes)
    said = effect_phrase(effect, "believed")
    assert "{" not in said
    assert "--" not in said
    assert ("95 %" in said) == bounded


if __name__ == "__main__":
    KEPT.write_text(texts(), encoding="utf-8")
    sys.stdout.write(f"{KEPT}\n")
