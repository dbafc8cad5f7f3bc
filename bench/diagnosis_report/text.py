"""A diagnosis as Markdown."""

from bench.diagnosis_report import tables
from bench.diagnosis_report.numbers import clean
from bench.diagnosis_report.remedy import remedy
from bench.diagnosis_report.sentences import (
    next_flight,
    remarks,
    shrink_sentence,
    verdict,
    where_sentence,
)
from bench.text import markdown
from diagnosis.result import Diagnosis
from simulators.effects.card import load_card


def diagnosis_text(diagnosis: Diagnosis) -> str:
    """The whole diagnosis as a Markdown document."""
    parts = [f"# {markdown.escape(tables.title(diagnosis))}"]
    parts.append(f"**{markdown.escape(verdict(diagnosis))}**")
    parts += [markdown.escape(line) for line in remarks(diagnosis)]
    facts = [f"{name}: {markdown.escape(value)}" for name, value in tables.facts(diagnosis)]
    reference = tables.reference_name(diagnosis)
    if reference is not None:
        facts.append(f"reference: {markdown.escape(reference)}")
    parts += ["; ".join(facts) + "."]
    if diagnosis.interface:
        parts += ["## What the logs say wrongly", *_table(tables.interface_table(diagnosis))]
    parts += ["## What to change", *map(markdown.escape, remedy(diagnosis))]
    if diagnosis.blamed:
        parts += ["## How far the gap shrinks", markdown.escape(shrink_sentence(diagnosis))]
        parts += _table(tables.shrink_table(diagnosis))
    parts += ["## Where the gap lies", markdown.escape(where_sentence(diagnosis))]
    parts += _table(tables.where_table(diagnosis))
    parts += ["## What explains it", *_effects(diagnosis)]
    for table in (
        tables.candidates_table,
        tables.support_table,
        tables.shared_table,
        tables.followed_table,
    ):
        parts += _table(table(diagnosis))
    silent = [tables.not_observable_table(diagnosis), tables.limits_table(diagnosis)]
    if any(silent):
        parts += ["## What these flights cannot tell", *(t for s in silent for t in _table(s))]
    if advice := next_flight(diagnosis):
        parts += ["## What to fly next", markdown.escape(advice)]
    parts += ["## Flights", *_table(tables.left_out_table(diagnosis))]
    parts += _table(tables.flights_table(diagnosis))
    parts += _table(tables.noise_table(diagnosis))
    return "\n\n".join(parts) + "\n"


def _effects(diagnosis: Diagnosis) -> list[str]:
    parts = []
    for effect in diagnosis.effects:
        words = load_card(clean(effect.name))
        heading = markdown.escape(tables.effect_heading(effect))
        parts.append(f"**{heading}**. {words.physics}".strip())
        parts += _table(tables.parameters_table(effect))
    return parts


def _table(table: tables.Table | None) -> list[str]:
    """Caption and table, or nothing."""
    if table is None or not table.rows:
        return []
    lines = markdown.text_table(table.headings, table.rows, table.left)
    return [f"{markdown.escape(table.caption)}:", lines]
