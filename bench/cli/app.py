"""The command line: what users type, and nothing else.

A command is a function that an entry point of the group `bench.commands` names; other packages add
theirs by the same door. Whatever needs JAX or pandas is imported inside of the functions, so that
help appears at once.
"""

import signal
import sys

import cyclopts

from bench.execution.signals import handled
from bench.text.errors import UsageError
from simulators import registry

USAGE_ERRORS = (UsageError, registry.UnknownPluginError, registry.BrokenPluginError)
"""What ends a command with exit status 2 and one line on stderr."""


def make_app() -> cyclopts.App:
    """The program with all commands that import; each other one is named on stderr."""
    app = cyclopts.App(
        name="bench",
        help="How should drone-swarm policies be trained across simulator fidelities?",
        version_flags=[],
    )
    for name in registry.names("command"):
        try:
            app.command(registry.load("command", name), name=name)
        except registry.BrokenPluginError as error:
            _complain(str(error))
    return app


def main(arguments: list[str] | None = None) -> int:
    """Exit status of the command in `arguments`, by default those of this process.

    0: all is well. 1: a run failed or could not be started. 2: what was asked for makes no sense;
    one line on stderr says why, nothing was done. 130: interrupted, by Ctrl-C or SIGTERM.
    """
    try:
        # Like Ctrl-C, so that processes that were started end, too.
        with handled(signal.SIGTERM, signal.default_int_handler):
            status = make_app()(
                sys.argv[1:] if arguments is None else arguments,
                exit_on_error=False,
                print_error=False,
                result_action="return_value",
            )
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
