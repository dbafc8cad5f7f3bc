"""`bench verify`: a submission, checked by training one of its seeds again."""

from pathlib import Path

from bench.cli.checks import check_files, check_names, check_number, check_place


def verify(
    folder: Path,
    /,
    *,
    task: str = "",
    team_size: int | None = None,
    seed: int | None = None,
    jobs: int | None = None,
    out: Path | None = None,
) -> int:
    """Check a folder of `bench submit`, train one of its seeds again and compare the row.

    Says match, differs or cannot tell (exit status 0, 3, 4). Trainings are chaotic across
    processors, so that a row which is not reproduced to the digit is compared with what one more
    seed would give, by the scatter of the submitted seeds. With fewer than three seeds nothing can
    be told.

    Parameters
    ----------
    folder
        The submission.
    task
        Train a row of this task; default: one at random of the smallest team.
    team_size
        Train a row of this number of drones.
    seed
        Train a row of this seed.
    jobs
        Number of worker processes, where the method has parents that are trained, too.
    out
        Folder for what is trained, from which the same command resumes; default: a temporary one.
    """
    check_files([folder])
    check_names("task", [task] if task else [])
    check_number("jobs", jobs)
    check_place(*([out] if out else []))
    from rich.console import Console

    from bench.sharing.submission.retrained import verify as verify_folder

    return verify_folder(
        folder, Console(), task=task, team_size=team_size, seed=seed, jobs=jobs, out=out
    )
