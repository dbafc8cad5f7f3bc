"""A diagnosis as entries of crazyflow's own parameter file, and the effects beside them."""

from collections.abc import Mapping
from typing import Any

from diagnosis.correction import corrected, parameters_of
from diagnosis.result import Diagnosis
from simulators import registry
from simulators.crazyflow import Crazyflow
from simulators.crazyflow_params import PARAMS_FILE


def patch_text(diagnosis: Diagnosis) -> str:
    """The patch as TOML: a table of crazyflow's file, and a table an effect that it lacks.

    Raises:
        ValueError: The diagnosis has no size of an effect.
    """
    likeliest = not diagnosis.blamed
    simulator = corrected(diagnosis, likeliest=likeliest)
    values = parameters_of(diagnosis, likeliest=likeliest)
    if isinstance(simulator, Crazyflow):
        changed, others = simulator.file_params()
        names = {type(effect) for effect in others}
    else:
        changed, names = {}, None
    lines = [
        f"# Verdict: {diagnosis.verdict}.",
        f"# [{diagnosis.flights.drone}] replaces these entries of crazyflow's {PARAMS_FILE}.",
        "# [effects.NAME]: effects of fidelity-bench that no entry stands for, SI units.",
    ]
    if diagnosis.verdict != "effect":
        lines.append(
            "# Descriptive: these numbers may be biased; look at them, do not rely on them."
        )
    if changed:
        lines += ["", f"[{diagnosis.flights.drone}]", *_entries(changed)]
    for name, own in values.items():
        if names is None or registry.load("effect", name) in names:
            lines += ["", f"[effects.{name}]", *_entries(own)]
    return "\n".join(lines) + "\n"


def _entries(values: Mapping[str, Any]) -> list[str]:
    return [f"{key} = {_written(value)}" for key, value in values.items()]


def _written(value: Any) -> str:
    """A number or a list of lists of numbers in TOML, with seven significant digits."""
    if isinstance(value, list):
        return f"[{', '.join(map(_written, value))}]"
    return repr(float(f"{value:.7g}"))
