"""`bench diagnose`: why a simulator and real flights differ."""

from pathlib import Path
from typing import Annotated

from bench.cli.checks import (
    check_flights,
    check_names,
    check_reality,
    check_unused,
    earlier_diagnosis,
)
from bench.cli.options import Remedy, Repeatable
from bench.execution.environment import compute_here
from bench.text.errors import UsageError


def diagnose(
    flights: Path | None = None,
    /,
    *,
    simulator: str | None = None,
    reference: Path | None = None,
    out: Path | None = None,
    exclude: Annotated[list[str] | None, Repeatable] = None,
    deploy: str | None = None,
    reality: str | None = None,
    team_size: int | None = None,
    seeds: int | None = None,
    change: Remedy = Remedy(),  # noqa: B008 - frozen
) -> int:
    """Say why a simulator and real flights differ: where, which effect, how much it explains.

    Writes diagnosis.json, diagnosis.md and diagnosis.html, a page that opens offline; writes
    nothing if no flight is usable. With --deploy, it measures what a diagnosis is worth to a team:
    it trains policies in the nominal and in the corrected simulator and deploys them in --reality.

    Parameters
    ----------
    flights
        Folder with vehicle.toml and flights/NAME.parquet or .csv; with --remedy also an earlier
        diagnosis: its folder or its diagnosis.json.
    simulator
        Simulator to compare the flights with; default: crazyflow, or point_mass for an airframe
        that crazyflow has no file of.
    reference
        Folder of flights of the same vehicle before a change; the diagnosis then says what
        changed.
    out
        Folder for the documents; default: reports/diagnosis/NAME for flights in a folder NAME.
    exclude
        Do not consider this effect, nor effects that flights can hardly tell from it; may be
        repeated.
    deploy
        Task to train for and to deploy in --reality; needs no flights.
    reality
        Simulated reality for --deploy, such as "crazyflow+mass(e=0.2)+wind(x=1)".
    team_size
        Number of drones for --deploy; default: 3.
    seeds
        Number of seeds for --deploy; default: 1.
    """
    if (flights is None) == (deploy is None) or (deploy is None) != (reality is None):
        raise UsageError("Give either a folder of flights, or --deploy TASK with --reality.")
    others = {"--simulator": simulator, "--reference": reference, "--exclude": exclude}
    if deploy is None:
        check_unused({"--team-size": team_size, "--seeds": seeds}, "without --deploy")
    else:
        check_unused(others | {"--remedy": change.remedy}, "with --deploy")
    if change.remedy is not None and flights is not None:
        flights = earlier_diagnosis(flights)
    change.check(flights, others)
    check_names("simulator", [simulator] if simulator else ())
    check_names("effect", exclude or ())
    check_names("task", [deploy] if deploy else ())
    if reality is not None:
        check_reality(reality)
    folders = (None if change.of_file(flights) else flights, reference)
    check_flights([folder for folder in folders if folder is not None])
    compute_here()
    if flights is not None:
        from bench.diagnosis_report.command import place_of, run_diagnosis

        if change.of_file(flights):
            return change.write(flights, out)
        out = out or place_of(flights)
        run_diagnosis(flights, simulator, reference, exclude or (), out)
        return change.write(out)
    from bench.diagnosis_report.deploy import deploy as deploy_team

    assert deploy is not None and reality is not None  # noqa: PT018 - asked above
    place = out or Path("reports") / "diagnosis" / f"deploy-{deploy}"
    team_size, seeds = (3 if team_size is None else team_size), (1 if seeds is None else seeds)
    return deploy_team(deploy, reality, team_size, seeds, place)
