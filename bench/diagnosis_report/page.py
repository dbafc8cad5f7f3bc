"""A diagnosis as one HTML page that loads nothing and runs no script."""

import re

from markupsafe import Markup, escape

from bench.diagnosis_report import figures, tables
from bench.diagnosis_report.gap_text import added, shrink_sentence, where_sentence
from bench.diagnosis_report.remedy import CODE, remedy
from bench.diagnosis_report.sentences import (
    kind_label,
    next_flight,
    remarks,
    verdict,
)
from bench.text.numbers import is_number, quantity
from bench.text.pages import environment, unbroken
from bench.text.words import clean
from diagnosis.result import Diagnosis
from simulators.effects.card import load_card


def diagnosis_page(diagnosis: Diagnosis) -> str:
    """The whole diagnosis as an HTML document."""
    template = environment().get_template("diagnosis.html.j2")
    return template.render(
        d=diagnosis,
        tables=tables,
        figures=figures,
        title=tables.title(diagnosis),
        kind_label=kind_label(diagnosis),
        verdict=verdict(diagnosis),
        remarks=remarks(diagnosis),
        shrink=shrink_sentence(diagnosis),
        added=added(diagnosis),
        drift=_drift(diagnosis),
        where=where_sentence(diagnosis),
        effects=_effects(diagnosis),
        remedy=[_with_code(line) for line in remedy(diagnosis)],
        next_flight=next_flight(diagnosis),
    )


def _with_code(line: str) -> Markup:
    """A line in which what can be copied into a terminal or a program is marked as code."""
    parts = re.split(f"({'|'.join(map(re.escape, CODE))})", line)
    marked = (
        Markup("<code>{}</code>").format(part) if part in CODE else escape(unbroken(part))
        for part in parts
    )
    return Markup("").join(marked)


def _effects(diagnosis: Diagnosis) -> list[dict[str, object]]:
    """Heading, physics and parameters of every effect of the likeliest set."""
    return [
        {
            "heading": tables.effect_heading(diagnosis, effect),
            "physics": load_card(clean(effect.name)).physics,
            "parameters": tables.parameters_table(effect),
        }
        for effect in diagnosis.effects
    ]


def _drift(diagnosis: Diagnosis) -> list[tuple[str, str, float]]:
    """Name, size and relative length of the bars without and with the effects, if measured."""
    sizes = (("without", diagnosis.shrink.before), ("with", diagnosis.shrink.after))
    known = [(name, size) for name, size in sizes if is_number(size)]
    if len(known) < len(sizes):
        return []
    longest = max(size for _, size in known) or 1.0
    return [(name, quantity(size, "m", 2), size / longest) for name, size in known]
