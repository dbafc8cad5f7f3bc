"""The claims, each with the rule that judges it; nothing here is measured or typed in.

Source of the paper's: Mednikov and Gal, "Calibrate Once, Fly Any Team" (arXiv 2609.17265), Sec. V.
"""

from typing import NamedTuple

from bench.paper.number_rules import AtMost, Cheaper, Grows, OnlyOneHolds
from bench.paper.return_rules import Above, EnoughFlights, GapAtMost, GapNarrows, Shortfall
from bench.paper.rule import AbstractRule
from bench.paper.values import (
    AFFINE,
    CLEAN,
    GREY_BOX,
    HOTSTART,
    HYBRID,
    LF,
    ONCE,
    RANDOMIZED,
    RECALIBRATED,
    SCRATCH,
    SINDY,
    TRACKED,
    off_spec,
)

PAPER, BUDGET, OFF_SPEC, OWN = (
    "The paper's claims",
    "With fewer calibration flights (Sec. V-B)",
    "On a drone that is off its specification (Sec. V-C)",
    "Beyond the paper",
)
"""Sections of the page, in order."""
PAPER_LOSSES = frozenset({("circle", 3), ("figure8", 3)})
"""Cells in which the paper's HF scratch beats its Hybrid."""
COLLAPSE = 1.4
"""A residual class collapses where it loses more than so many times what the best class loses; our
reading: of the paper's Table I it marks the cells that the text names, and affine on circle at
N = 12."""


DEPLOYED, TRAINING, BILLS = "deployed", "training", "bills"
"""What a claim is about: policies in high fidelity (deployed, or while they train), their training
in low fidelity, or what a configuration flies by its settings, which holds by construction."""


class Claim(NamedTuple):
    """A claim and its rule."""

    section: str
    title: str
    """What is claimed, in our words."""
    stated: str
    """The number that goes with it; of a claim beyond the paper, the aim."""
    rule: AbstractRule
    lines: int = 0
    """Lines of the detail table when all was run that the claim is about, such as 24 cells; with
    fewer, nothing refutes it at most. 0: the claim is about whatever was run."""
    of: str = DEPLOYED
    """`DEPLOYED`, `TRAINING` or `BILLS`."""


GRID, TABLE, WORLDS, SIZES, TASKS = 24, 8, 18, 6, 4
"""Cells of the paper's grid, of its Table I, of its off-spec drones; its team sizes and tasks."""
CLAIMS = (
    Claim(
        PAPER,
        "Hybrid deploys above the LF baseline in every cell",
        "24 of 24 cells",
        Above(HYBRID, LF),
        GRID,
    ),
    Claim(
        PAPER,
        "Hybrid deploys above HF scratch nearly everywhere",
        "22 of 24 cells (not circle and figure8 at N = 3)",
        Above(HYBRID, SCRATCH, but=PAPER_LOSSES),
        GRID - len(PAPER_LOSSES),
    ),
    Claim(
        PAPER,
        "HF scratch never exceeds the training return of hot start",
        "0 of 24 cells",
        Above(HOTSTART, SCRATCH, metric="training_reward"),
        GRID,
    ),
    Claim(
        PAPER,
        "The gap of Hybrid to hot start narrows with team size",
        "about 22 % at N = 3, under 1 % from N = 12",
        GapNarrows(HYBRID, HOTSTART),
        SIZES,
    ),
    Claim(
        PAPER,
        "From N = 12, Hybrid is within 1 % of hot start",
        "under 1 %",
        GapAtMost(HYBRID, HOTSTART, bound=0.01, from_size=12),
        2 * TASKS,
    ),
    Claim(
        PAPER,
        "Of the paper's methods, Hybrid needs the least HF flight, scratch the most",
        "Hybrid 20 fleet-minutes at N = 3 (40 by the flights that it states) and 190 at N = 18; "
        "hot start 70 to 1100; scratch 300 to 5900",
        Cheaper((HYBRID, HOTSTART, SCRATCH)),
        SIZES,
        BILLS,
    ),
    Claim(
        PAPER,
        "Hybrid has no HF training crash",
        "0 at every team size",
        AtMost(HYBRID, "training_crashes", 0.0, "the number of HF training crashes"),
        GRID,
        of=BILLS,
    ),
    Claim(
        PAPER,
        "Crashes of HF training grow with team size",
        "crash-step rate at N = 18: scratch 16 to 63 %, hot start 2 to 15 %",
        Grows(
            (SCRATCH, HOTSTART),
            "training_crash_step_rate",
            "the share of training steps in contact [%]",
            factor=100.0,
        ),
        2 * TASKS,
    ),
    Claim(
        PAPER,
        "The MLP ensemble is the only residual class that collapses nowhere",
        "affine collapses on circle and pitchandexpand at N = 3, SINDy degrades at N = 12 on "
        "circle and figure8",
        OnlyOneHolds(HYBRID, (AFFINE, SINDY), factor=COLLAPSE),
        TABLE,
    ),
    Claim(
        BUDGET,
        "LF trails Hybrid widely",
        "by 18 to 164 %",
        Shortfall(LF, HYBRID, low=0.18, sizes=(3, 7, 12)),
        12,
    ),
    Claim(
        BUDGET,
        "32 calibration flights come close to the whole pool, whatever the team size",
        "within roughly 10 to 15 %",
        EnoughFlights(32, share=0.15),
        12,
    ),
    Claim(
        BUDGET,
        "On circle 8 calibration flights are nearly enough",
        "within roughly 10 %",
        EnoughFlights(8, share=0.10, task="circle"),
        3,
    ),
    Claim(
        OFF_SPEC,
        "Recalibrated on the off-spec drone, Hybrid deploys above the LF baseline there",
        "every cell",
        Above(RECALIBRATED, LF, source=off_spec),
        WORLDS,
    ),
    Claim(
        OFF_SPEC,
        "Recalibrated, it deploys above PD tracking",
        "on figure8 by its text; on circle the margin narrows under drag",
        Above(RECALIBRATED, TRACKED, source=off_spec),
        WORLDS,
    ),
    Claim(
        OFF_SPEC,
        "Recalibrated, Hybrid keeps the return that it has on the unchanged drone",
        "loses at most 24 % on figure8; on circle 4 to 16 %",
        Above(RECALIBRATED, CLEAN, share=0.25, source=off_spec),
        WORLDS,
    ),
    Claim(
        OFF_SPEC,
        "PD tracking trails the uncorrected LF baseline on figure8",
        "every cell",
        Above(LF, TRACKED, source=off_spec, task="figure8"),
        WORLDS // 2,
    ),
    Claim(
        OWN,
        "LF policies solve the task in LF",
        "position error of at most 0.15 m",
        AtMost(LF, "lf_position_error", 0.15, "the position error in low fidelity [m]"),
        GRID,
        of=TRAINING,
    ),
    Claim(
        OWN,
        "Hybrid deploys above the LF baseline in most cells",
        "20 of 24 cells",
        Above(HYBRID, LF, at_least=20 / 24),
        GRID,
    ),
    Claim(
        OWN,
        "Grey box deploys above Hybrid in every cell",
        "24 of 24 cells",
        Above(GREY_BOX, HYBRID),
        GRID,
    ),
    Claim(
        OWN,
        "Grey box loses at most 10 % more than hot start in most cells",
        "20 of 24 cells",
        Above(GREY_BOX, HOTSTART, share=0.10, at_least=20 / 24),
        GRID,
    ),
    Claim(
        OWN,
        "Grey box needs half a fleet-minute",
        "at most 0.5",
        AtMost(GREY_BOX, "fleet_minutes", 0.5, "the HF flight [fleet-minutes]"),
        GRID,
        of=BILLS,
    ),
    Claim(
        OWN,
        "Identification adds something: grey box deploys above domain randomization in every cell",
        "24 of 24 cells",
        Above(GREY_BOX, RANDOMIZED),
        GRID,
    ),
    Claim(
        OWN,
        "One calibration serves every team: Hybrid once loses at most 10 % more than Hybrid",
        "12 of 12 cells, with 3, 12 and 18 drones",
        Above(ONCE, HYBRID, share=0.10),
        12,
    ),
)
"""All claims, in the order of the page."""
