"""Slurm's commands, as far as submitit calls them, with processes of this machine as jobs.

`install` puts them on the PATH. FAKE_SLURM names the folder that holds the scripts, the sizes of
their arrays (`arrays`), and the state and process of every job (`JOB.state`, `JOB.pid`).
"""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path


def install(patch, place):
    """Puts the commands of a cluster that takes arrays of three jobs on the path."""
    (place / "bin").mkdir(parents=True)
    for name in ("sbatch", "srun", "sacct", "scancel", "scontrol"):
        program = place / "bin" / name
        program.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{__file__}" {name} "$@"\n')
        program.chmod(0o755)
    patch.setenv("PATH", os.pathsep.join((str(place / "bin"), os.environ["PATH"])))
    patch.setenv("FAKE_SLURM", str(place))


def say(text):
    sys.stdout.write(f"{text}\n")


def home():
    return Path(os.environ["FAKE_SLURM"])


def sbatch(script):
    """Starts each job of a script, in a session of its own, and says its number."""
    text = Path(script).read_text()
    array = re.search(r"^#SBATCH --array=0-(\d+)", text, re.MULTILINE)
    number = str(time.time_ns() // 1_000_000)  # no other cluster of this process had it
    (home() / f"{number}.script").write_text(text)
    names = [f"{number}_{i}" for i in range(int(array[1]) + 1)] if array else [number]
    with (home() / "arrays").open("a") as file:
        file.write(f"{len(names)}\n")
    for name in names:
        (home() / f"{name}.state").write_text("RUNNING")
        command = [sys.executable, __file__, "job", name, script]
        subprocess.Popen(
            command,
            start_new_session=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    say(f"Submitted batch job {number}")


def job(name, script):
    """A job from its start to its end."""
    (home() / f"{name}.pid").write_text(str(os.getpid()))
    number, _, index = name.partition("_")
    variables = {
        "SLURM_JOB_ID": number,
        "SLURM_NTASKS": "1",
        "SLURM_JOB_NUM_NODES": "1",
        "SLURM_NODEID": "0",
        "SLURM_PROCID": "0",
        "SLURM_LOCALID": "0",
        "SLURM_JOB_NODELIST": "localhost",
    }
    if index:
        variables |= {"SLURM_ARRAY_JOB_ID": number, "SLURM_ARRAY_TASK_ID": index}
    status = subprocess.run(["bash", script], env=os.environ | variables, check=False).returncode
    (home() / f"{name}.state").write_text("FAILED" if status else "COMPLETED")


def srun(*arguments):
    """Becomes the command after the options."""
    start = next(i for i, word in enumerate(arguments) if word == sys.executable)
    os.execv(arguments[start], arguments[start:])


def sacct(*arguments):
    """The states of the jobs that are asked for."""
    asked = [arguments[i + 1] for i, word in enumerate(arguments) if word == "-j"]
    say("JobID|State|NodeList")
    for path in sorted(home().glob("*.state")):
        if path.stem.split("_")[0] in asked:
            say(f"{path.stem}|{path.read_text()}|localhost")


def scancel(name):
    """Kills a job with all its processes."""
    while not (path := home() / f"{name}.pid").exists():
        time.sleep(0.02)
    (home() / f"{name}.state").write_text("CANCELLED")
    os.killpg(int(path.read_text()), signal.SIGKILL)


def scontrol(*_):
    """The configuration."""
    say("AccountingStorageType = none\nMaxArraySize            = 3\nMaxJobCount = 10000")


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
