"""What the tables and their columns mean, for formats that describe data sets; and their files."""

from pathlib import Path

from bench.store.tables import LARGE, SCHEMAS, Tables

LICENSE = "mit"
"""Licence of the tables, as of this package; all formats write it small."""
CITATION = (
    "fidelity-bench contributors: fidelity-bench, a benchmark of training drone-swarm policies "
    "across simulator fidelities. It implements Mednikov and Gal, Calibrate Once, Fly Any Team, "
    "arXiv:2609.17265."
)
"""How to cite the tables, and what they rest on."""
ABOUT = (
    "Results of fidelity-bench: how drone-swarm policies are trained across simulator fidelities, "
    "what they are worth in the high-fidelity simulator, and what the training cost. A run is one "
    "policy, trained with one seed and evaluated from the fixed initial states of its cell."
)
"""What a collection of tables is."""
TABLE_WORDS = {
    "results": "One row per evaluated run and metric.",
    "curves": "One row per run and epoch of its training.",
    "trajectories": "One row per run, drone and sample (10 Hz) of the first evaluation episode.",
    "runs": "One row per run, failed ones too: what it is and where it comes from.",
}
"""What a table has a row for."""
COLUMN_WORDS = {
    "run": "Name of the run; its end is the start of its key.",
    "method": "Registered name of the method.",
    "residual": "Registered name of the residual; empty for methods that take none.",
    "variant": "Settings that are not the defaults, as canonical text; empty for none.",
    "task": "Registered name of the task.",
    "team_size": "Number of drones.",
    "seed": "Seed of the training.",
    "simulator": "High-fidelity simulator in which the policy was evaluated.",
    "trained_effects": "Effects of the simulator in which it was trained, as canonical text; those "
    "that a method itself adds or draws are told by its settings alone.",
    "deployed_effects": "Effects of the simulator in which it was evaluated.",
    "calibration_flights": "Calibration flights that were billed.",
    "metric": "Name of the metric.",
    "value": "Its value, a mean over the episodes of the evaluation where it is one of an episode.",
    "unit": "Its unit; empty for the notes of a method.",
    "status": "How the run ended: ok, failed, diverged or budget.",
    "epoch": "Epoch of the training, from 0.",
    "reward": "Mean return of the epoch's episodes.",
    "smooth_reward": "Mean return under the smoothed reward that is differentiated.",
    "crashes": "Crashes in the epoch.",
    "grad_norm": "Norm of the gradient before clipping.",
    "drone": "Number of the drone, from 0.",
    "t": "Time since the reset [s].",
    "pos_x": "Position, world frame [m].",
    "pos_y": "Position, world frame [m].",
    "pos_z": "Height, world frame [m].",
    "cause": "Why a failed run failed; empty for others.",
    "settings": "All settings of method and task, as JSON.",
    "versions": "Declared versions of the plug-ins and versions of packages, as JSON.",
    "key": "Hash of everything that determines the result.",
    "committed": "When the run was stored (ISO 8601).",
    "commit": "Git commit of the program; empty where unknown.",
    "dirty": "Whether the program had changes that are in no commit.",
    "program": "Hash of the source code that the run's plug-ins ran.",
    "machine": "Processor.",
    "device": "What JAX computed on.",
}
"""What a column holds, in any table."""


def save_tables(tables: Tables, folder: Path) -> dict[str, Path]:
    """Writes the tables into a folder; returns the file of each that is not empty.

    A table that a repository may leave out is left out where it has no rows.
    """
    tables.save(folder)
    found = {name: folder / f"{name}.parquet" for name in SCHEMAS}
    for name in LARGE:
        if not len(getattr(tables, name)):
            found.pop(name).unlink()
    return found
