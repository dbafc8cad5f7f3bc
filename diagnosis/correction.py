"""The simulator with what a diagnosis found in it, to fly or to train in."""

from pathlib import Path

from diagnosis.replay.believed import believed_simulator
from diagnosis.replay.library import FAR, Slot
from diagnosis.result import Diagnosis, Effect
from simulators import registry
from simulators.contract import AbstractSimulator, with_effects
from simulators.effects.card import load_card


def corrected(diagnosis: Diagnosis | Path | str, *, likeliest: bool = False) -> AbstractSimulator:
    """The diagnosed simulator with the effects that the verdict blames, at their sizes.

    Airframe and mass are those of the flights. If the diagnosis had reference flights, what they
    already showed is in the simulator too, and the sizes act on top of it; if a twin was learned
    from them (`followed`), no effect says what they showed, and only what changed is in the
    simulator. Under `none` and `too_few`, it is the simulator as it was. A size beyond what its
    parameter may be, such as a delay that is shorter than the simulator's own, acts as far as it
    may. An effect with an onset, such as a gust, sets in at that time after every reset.

    Args:
        diagnosis: A diagnosis, or the path of a `diagnosis.json`.
        likeliest: Whether effects of the likeliest set act that the verdict does not blame, too;
            their sizes are descriptive only.

    Raises:
        ValueError: The file is no diagnosis, its flights were compared with nothing, the verdict
            blames nothing and `likeliest` was not given, or a size or the mass is not in the file.
        UnknownPluginError: An effect of the diagnosis is not registered here.
    """
    found = diagnosis if isinstance(diagnosis, Diagnosis) else Diagnosis.load(Path(diagnosis))
    if not found.compared:
        raise ValueError(
            "`diagnosis` corrects nothing: its logs must be mended first, and then diagnosed again."
        )
    if found.verdict == "unexplained" and not likeliest:
        named = ", ".join(effect.name for effect in found.effects) or "empty"
        raise ValueError(
            "`diagnosis` has the verdict 'unexplained': no effect is confirmed. Give "
            f"likeliest=True to use the likeliest set ({named}) all the same."
        )
    if (mass := found.flights.mass) is None:
        raise ValueError("`diagnosis` does not say the vehicle's mass. Diagnose the flights again.")
    flown = found.flights
    nominal = believed_simulator(
        found.settings.simulator, flown.drone, mass, airframe=flown.airframe
    )
    values = parameters_of(found, likeliest=likeliest)
    return with_effects(
        nominal, [registry.load("effect", name)(**own) for name, own in values.items()]
    )


def parameters_of(found: Diagnosis, *, likeliest: bool = False) -> dict[str, dict[str, float]]:
    """Parameters of the corrected simulator by effect, SI: those of the reference, then the found.

    Raises:
        ValueError: A size is not in the file.
    """
    values: dict[str, dict[str, float]] = {}
    for known in found.details.shared:
        values.setdefault(known.effect, {})[known.parameter] = known.value
    for effect in found.effects if likeliest else found.blamed:
        _put(values.setdefault(effect.name, {}), effect)
    return values


def _put(values: dict[str, float], effect: Effect) -> None:
    """Writes the sizes of an effect over those of the reference flights, on which they stand."""
    if not effect.parameters:
        raise ValueError(f"`diagnosis` has no size of '{effect.name}'. Diagnose the flights again.")
    kinds = registry.load("effect", effect.name).parameters
    lower = load_card(effect.name).low_if_mapped
    for parameter in effect.parameters:
        info, neutral = kinds[parameter.name], min(kinds[parameter.name].neutral, FAR)
        slot = Slot(
            effect.name, parameter.name, info.unit, neutral, info.low, info.high, info.factor
        )
        base = values.get(parameter.name)
        size = min(max(parameter.value, lower.get(parameter.name, info.low)), info.high)
        values[parameter.name] = size if base is None else slot.on_top(size, base)
