"""A diagnosis as one HTML page that loads nothing and runs no script."""

from bench.diagnosis_report import figures, tables
from bench.diagnosis_report.effect_words import effect_words
from bench.diagnosis_report.numbers import clean, is_number, probability, quantity
from bench.diagnosis_report.sentences import (
    Json,
    Request,
    helped,
    remarks,
    shrink_sentence,
    verdict,
    where_sentence,
)
from bench.text.pages import environment

KINDS = {"effect": "Explained", "none": "Nothing beyond noise", "unexplained": "Unexplained"}
"""What the verdicts are called."""


def diagnosis_page(diagnosis: Json, request: Request) -> str:
    """The whole diagnosis as an HTML document."""
    before_after = figures.before_after_panels(diagnosis)
    return (
        environment()
        .get_template("diagnosis.html.j2")
        .render(
            title=f"Diagnosis of {clean(request.flights)}",
            reference=None if request.reference is None else clean(request.reference),
            kind=diagnosis["verdict"],
            kind_label=KINDS[diagnosis["verdict"]],
            verdict=verdict(diagnosis, request),
            remarks=remarks(diagnosis, request),
            facts=tables.facts(diagnosis),
            explained=helped(diagnosis),
            shrink=shrink_sentence(diagnosis),
            drift=_drift(diagnosis),
            before_after=before_after,
            more_flights=len(tables.details(diagnosis, "before_after")) - len(before_after),
            shrink_table=tables.shrink_table(diagnosis),
            where=where_sentence(diagnosis),
            where_table=tables.where_table(diagnosis),
            in_time=figures.time_panels(diagnosis),
            regimes=figures.regime_panels(diagnosis),
            effects=_effects(diagnosis),
            candidates=tables.candidates_table(diagnosis),
            support=tables.support_table(diagnosis),
            shared=tables.shared_table(diagnosis),
            not_observable=tables.not_observable_table(diagnosis),
            limits=tables.limits_table(diagnosis),
            next_flight=clean(diagnosis.get("next_flight") or ""),
            left_out=tables.left_out_table(diagnosis),
            flights=tables.flights_table(diagnosis),
            noise=tables.noise_table(diagnosis),
        )
    )


def _effects(diagnosis: Json) -> list[dict[str, object]]:
    """Label, physics, probability and parameters of every effect found."""
    found = []
    for effect in diagnosis["effects"]:
        words = effect_words(clean(effect["name"]))
        found.append(
            {
                "label": words.label,
                "physics": words.physics,
                "probability": probability(effect.get("probability")),
                "parameters": tables.parameters_table(effect),
            }
        )
    return found


def _drift(diagnosis: Json) -> list[tuple[str, str, float]]:
    """Name, size and relative length of the bars before and after; empty if not measured."""
    shrink = diagnosis.get("shrink") or {}
    sizes = [(name, shrink.get(name)) for name in ("before", "after")]
    known = [(name, size) for name, size in sizes if is_number(size)]
    if len(known) < len(sizes):
        return []
    longest = max(size for _, size in known) or 1.0
    unit = shrink.get("unit", "m")
    return [(name, quantity(size, unit, 2), size / longest) for name, size in known]
