"""What a finished study may say: which effects are blamed, and the verdict with them.

`judge` finds the likeliest set and asks what it leaves. Here every effect of it must stand by
itself, and the drift of flights that were left out must not grow where more is left than noise.
What leaves most of the gap is blamed for no part of it: of two sets of flights that differ in some
other way, something small is always like some effect.
"""

import dataclasses

from diagnosis.decide.study import Study
from diagnosis.decide.verdict import intervals
from diagnosis.result import VerdictKind
from diagnosis.result_parts import Shrink
from diagnosis.statements import verdict_of


@dataclasses.dataclass(frozen=True)
class Blame:
    """The verdict on a study."""

    verdict: VerdictKind
    """Its kind."""
    named: frozenset[str] | None
    """The whole likeliest set, if it is the answer."""
    blamed: frozenset[str]
    """Effects that are called a cause: the named ones, or those that left-out flights confirm."""


def blame(study: Study, shrink: Shrink) -> Blame:
    """The verdict on `study`; `shrink` is how far its effects shrink left-out flights' gap."""
    judged, chosen = study.verdict, study.verdict.chosen.effects
    standing = {name for name in chosen if _stands(study, name)}
    falls = shrink.percent is None or shrink.percent >= 0.0
    grows = bool(chosen) and judged.doubted and not falls
    kind = judged.kind if standing == chosen and not grows else "unexplained"
    helpful = {line.effect for line in study.support if line.confirmed} & standing
    most = judged.unexplained_share <= study.prepared.decision.most_left
    confirmed = frozenset(helpful) if most and not grows else frozenset()
    named = chosen if kind != "unexplained" else None
    return Blame(verdict_of(kind, bool(confirmed)), named, confirmed if named is None else named)


def _stands(study: Study, name: str) -> bool:
    """Whether an effect of the likeliest set may be named.

    It, or one that looks like it, is likelier than not, and some interval of it is clear of the
    neutral value. None of the 374 answers of the counted draws that name effects fails. Beside
    reference flights that the simulator does not follow at all, left-out flights must not deny it:
    there, evidence names a small second effect for what is only the simulator's.
    """
    judged, evidence, base = study.verdict, study.fits.evidence, study.prepared.base
    decision = study.prepared.decision
    denied = any(one.effect == name and one.confirmed is False for one in study.support)
    if denied and base is not None and base.floor.value > decision.structure:
        return False
    alike = {name, *judged.aliases[name]}
    share = sum(r.probability for r in judged.ranked if alike & r.effects)
    slots, (free, low, high) = evidence.library.slots, intervals(evidence, judged.chosen.fit)
    clear = any(
        slots[i].effect == name and not a <= slots[i].neutral <= b
        for i, a, b in zip(free, low, high, strict=True)
    )
    return clear and judged.true_share * share >= decision.least_chance
