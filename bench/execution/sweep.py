"""A sweep from beginning to end: execute what is missing, then tables and documents."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Console

from bench.execution.environment import seeds_together
from bench.execution.execute import Execution
from bench.execution.executor import AbstractExecutor, Name, usual_jobs
from bench.execution.progress import SweepProgress
from bench.plan.expansion import Plan
from bench.plan.planned_run import Run
from bench.plan.provenance import moved, provenance
from bench.report.terminal import rebuild_leaderboard, rebuild_report
from bench.stats.against import Beside, beside
from bench.store.kept import restorer
from bench.store.resume import Standing, make_standing, reproduces, stale_lines
from bench.store.reuse import reusable
from bench.store.store import Store
from bench.store.tables import Tables
from bench.text.errors import UsageError
from bench.text.say import say

INTERRUPTED = 130
"""Exit status after Ctrl-C."""
MOST_TRACEBACKS = 3
"""Tracebacks of failed runs whose paths are printed."""


def sweep(
    plan: Plan,
    tables_dir: Path,
    documents_dir: Path,
    jobs: int | None,
    *,
    executor: Name = "local",
    together: int | None = None,
    fail_fast: bool = False,
    retry_failed: bool = False,
    replace: bool = False,
    against: Path | None = None,
    reuse: Sequence[Path] = (),
) -> int:
    """Exit status: 0, 1 if anything failed or was left out, 130 after Ctrl-C.

    Options as in `bench run`.

    Raises:
        TableError: The tables that are there cannot be read.
        UsageError: Rows are of another program, and `replace` was not given.
    """
    console, errors = Console(), Console(stderr=True)
    warn = lambda text: say(errors, f"Warning: {text}")  # noqa: E731
    provenance()
    others = Tables.load(against) if against is not None else None
    store = Store(tables_dir)
    with store.lock(lambda: say(errors, f"Waiting: another run is working in {tables_dir}.")):
        store.tidy()
        sound = store.sound(warn)
        recorded = recorded_tables(tables_dir).merged(reusable(plan, reuse))
        kept = restorer([tables_dir, *reuse], recorded, warn)
        standing = make_standing(plan, sound, recorded, retry_failed, replace, kept)
        if standing.outdated and not replace:
            raise UsageError(_refusal(standing, tables_dir))
        if standing.outdated:
            say(console, f"Rows of {tables_dir} that will be replaced: {len(standing.outdated)}.")
        _make_way(standing, store, sound)
        stale = stale_lines(standing.done, recorded, sound)
        for text in (*stale, *(f"Left out: {x}" for x in plan.broken)):
            warn(text)
        for run in standing.restored:
            if (outcome := kept(run)) is not None:
                store.commit(run, outcome)
        missing = [run for run in plan.runs if run in standing.missing or run in standing.again]
        logs = store.runs / ".logs"
        chosen = executor if missing else "local"  # which starts nothing before it is needed
        with make_executor(chosen, jobs, max(1, len(missing)), logs) as workers:
            say(console, _announcement(standing, workers.slots))
            display = SweepProgress(missing, console)
            try:
                status = _train(
                    missing,
                    standing,
                    store,
                    workers,
                    display,
                    recorded,
                    together=together or seeds_together(),
                    fail_fast=fail_fast,
                )
            except KeyboardInterrupt:
                say(errors, _interruption(standing, store, len(plan.runs)))
                return INTERRUPTED
        sound |= store.sound(warn, [run.name for run in missing])
        found = store.tables(sound, {run.name for run in plan.runs})
        tables = _record(found, recorded, standing, tables_dir)
    if text := moved():
        warn(text)
    shown = Beside(tables, ()) if others is None else beside(tables, others, str(against))
    _document(shown, tables_dir, documents_dir, console)
    failed = [*standing.failed, *(run for run in missing if status.get(run.name) == "failed")]
    if failed:
        # Rows that stay may know nothing of it.
        causes = recorded.column("cause") | found.column("cause")
        _say_failures(failed, causes, len(plan.runs), store, errors)
    if left := len(missing) - len(status):
        say(errors, f"Stopped at the first failure: {left} runs are still to do.")
    return 1 if failed or plan.broken else 0


def _make_way(standing: Standing, store: Store, sound: dict[str, dict]) -> None:
    """Puts the folders of finished runs that are done again in quarantine."""
    for name in {*standing.outdated} & {run.name for run in standing.missing} & {*sound}:
        store.quarantine(name, "replaced: another program or machine made it")
        del sound[name]
    for run in (*standing.again, *standing.restored):
        if run.name in sound and sound[run.name]["status"] != "failed":
            store.quarantine(run.name, "replaced: a run starts from its residual, and it has none")
            del sound[run.name]


def _train(
    missing: Sequence[Run],
    standing: Standing,
    store: Store,
    workers: AbstractExecutor,
    display: SweepProgress,
    recorded: Tables,
    *,
    together: int,
    fail_fast: bool,
) -> dict[str, str]:
    """Status of each run that ended; parents that are trained again must reproduce their rows."""
    again = {run.name: recorded.metrics(run.name) for run in standing.again}

    def check(run: Run) -> str:
        if run.name not in again:
            return ""
        return reproduces(store.metrics(run.name), again[run.name])

    ready = [run.name for run in standing.done if run.name not in again]
    failed = [run.name for run in standing.failed]
    with display:
        execution = Execution(
            missing,
            store,
            workers,
            display,
            ready,
            failed,
            check=check,
            together=together,
            fail_fast=fail_fast,
        )
        return execution.result()


def _record(found: Tables, recorded: Tables, standing: Standing, tables_dir: Path) -> Tables:
    """Saves the rows of a sweep among those that are there; the tables."""
    arrived = {run for run, end in found.column("status").items() if end != "failed"}
    gone = {row for row, run in standing.outdated.items() if run in arrived}
    tables = recorded.merged(found, gone)
    tables.save(tables_dir)
    return tables


def _document(shown: Beside, tables_dir: Path, documents_dir: Path, console: Console) -> None:
    """Writes and shows the documents."""
    rebuild_report(shown.tables, documents_dir, console)
    rebuild_leaderboard(shown.tables, documents_dir, console)
    for text in (*shown.remarks, f"Tables: {tables_dir}"):
        say(console, text)


def _say_failures(
    failed: Sequence[Run],
    causes: Mapping[str, str],
    planned: int,
    store: Store,
    errors: Console,
) -> None:
    """Says how many runs failed, why the first one did, and where tracebacks are."""
    first = next((run for run in failed if causes.get(run.name)), failed[0])
    said = f"{first.label}: {causes.get(first.name, '')}"
    say(errors, f"{len(failed)} of {planned} runs failed; the first: {said}")
    for path in [p for run in failed if (p := store.traceback(run.name))][:MOST_TRACEBACKS]:
        say(errors, f"Traceback: {path}")


def recorded_tables(tables_dir: Path) -> Tables:
    """The tables in a folder, empty where there are none yet.

    Raises:
        TableError: They cannot be read.
    """
    signs = ["runs.parquet"]
    if not (tables_dir / "runs").is_dir():
        # Beside the runs' folders, results alone are what a first save left that was cut off.
        signs.append("results.parquet")
    there = any((tables_dir / name).is_file() for name in signs)
    return Tables.load(tables_dir) if there else Tables.empty()


def _refusal(standing: Standing, tables_dir: Path) -> str:
    named = next(iter(standing.outdated))
    return (
        f"{len(standing.outdated)} rows of {tables_dir} were made by another program (the first: "
        f"{named}). Nothing was run. Give --replace to train these runs again and replace their "
        "rows, or --out FOLDER to keep both."
    )


def _announcement(standing: Standing, slots: int) -> str:
    n_done, n_failed, n_missing = map(len, (standing.done, standing.failed, standing.missing))
    n_again, n_restored = len(standing.again), len(standing.restored)
    to_do = f"{n_missing}, on {slots} worker{'s' * (slots > 1)}" if n_missing else "nothing"
    text = f"Runs finished already: {n_done} of {n_done + n_failed + n_missing}. To do: {to_do}."
    if n_restored:
        text += f" Restored from kept policies, because others start from them: {n_restored}."
    if n_again:
        text += f" Trained again, because others start from their lost policies: {n_again}."
    if n_failed:
        text += f" Failed earlier: {n_failed}; --retry-failed tries them again."
    return text


def _interruption(standing: Standing, store: Store, planned: int) -> str:
    # By what is there: of runs done at once, some may have ended.
    ended = [r for r in standing.missing if store.status(r.name) not in ("", "failed")]
    return (
        f"Interrupted: {len(standing.done) + len(ended)} of {planned} runs are finished and kept. "
        "Give the same command again to resume."
    )


def make_executor(name: Name, jobs: int | None, most: int, logs: Path) -> AbstractExecutor:
    """An executor with `jobs` slots, but no more than `most`.

    Args:
        name: Which one.
        jobs: Number of slots; None: one per core, of the machine or of the Ray cluster, few on a
            machine with an accelerator, and up to 64 jobs of Slurm.
        most: Tasks that there will be.
        logs: Folder for what processes of this machine, or jobs, print.

    Raises:
        UsageError: It cannot be started.
    """
    if name == "ray":
        from bench.execution.cluster import RayExecutor

        return RayExecutor(jobs, most)
    if name == "slurm":
        from bench.execution.slurm import SlurmExecutor

        return SlurmExecutor(jobs, most, logs / "slurm")
    if name != "local":
        raise UsageError(f"`executor` must be 'local', 'ray' or 'slurm', got '{name}'.")
    from bench.execution.pool import LocalExecutor

    return LocalExecutor(max(1, min(jobs or usual_jobs(), most)), logs)
