"""The command line: what users type, and nothing else.

A command is a function that an entry point of the group `bench.commands` names; other packages add
commands in the same way. The functions import JAX and pandas themselves, so that help appears at
once.
"""

import importlib.metadata
import io
import os
import signal
import sys

import cyclopts

from bench.execution.signals import handled
from bench.text.errors import UsageError
from bench.text.words import clean
from diagnosis.logs.columns import LogError
from simulators import registry

USAGE_ERRORS = (UsageError, registry.UnknownPluginError, registry.BrokenPluginError)
"""Errors that end a command with exit status 2 and one line on stderr."""


def make_app() -> cyclopts.App:
    """The program with its commands; a command that cannot be imported is named on stderr."""
    app = cyclopts.App(
        name="bench",
        help="How should drone-swarm policies be trained across simulator fidelities?",
        version=lambda: f"fidelity-bench {importlib.metadata.version('fidelity-bench')}",
        version_flags=["--version"],
        suppress_keyboard_interrupt=False,  # `main` says that it was interrupted
    )
    app.register_install_completion_command(
        help="Install completion for bash, zsh or fish: for the shell that runs this command."
    )
    for name in registry.names("command"):
        try:
            app.command(registry.load("command", name), name=name)
        except registry.BrokenPluginError as error:
            _complain(str(error))
    return app


def main(arguments: list[str] | None = None) -> int:
    """Runs a command and returns its exit status.

    0: the command succeeded. 1: a run or a check failed, or a file could not be read or written.
    2: the request cannot be carried out; nothing was done, and one line on stderr says why.
    130: Ctrl-C or SIGTERM interrupted the command. A command may define further statuses.

    Args:
        arguments: The command and its arguments; None: those of this process.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a name that a terminal cannot show ends nothing
    # Editors and CI set a width of 0 where they know none; tables of that width would be empty.
    if os.environ.get("COLUMNS") == "0":
        del os.environ["COLUMNS"]
    # An accelerator's memory is for the processes that train.
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    try:
        # SIGTERM acts like Ctrl-C, so that the processes that a command started end, too.
        with handled(signal.SIGTERM, signal.default_int_handler):
            status = make_app()(
                sys.argv[1:] if arguments is None else arguments,
                exit_on_error=False,
                print_error=False,
                result_action="return_value",
            )
    except LogError as error:
        for line in str(error).splitlines():
            print(f"bench: {clean(line)}", file=sys.stderr)  # noqa: T201
        return 2
    except (cyclopts.CycloptsError, *USAGE_ERRORS) as error:
        _complain(str(error))
        return 2
    except OSError as error:
        _complain(str(error))
        return 1
    except KeyboardInterrupt:
        _complain("interrupted.")
        return 130
    return status or 0


def _complain(text: str) -> None:
    print(f"bench: {' '.join(text.split())}", file=sys.stderr)  # noqa: T201
