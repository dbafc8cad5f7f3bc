"""`bench check`: the conformance suite on a plug-in."""

from typing import Annotated

from bench.cli.checks import check_names, check_registered
from bench.cli.options import Repeatable
from bench.execution.environment import compute_here


def check(
    plugin: str,
    /,
    *,
    setting: Annotated[list[str] | None, Repeatable] = None,
    simulator: Annotated[list[str] | None, Repeatable] = None,
) -> int:
    """Run the conformance suite on a plug-in and say what is wrong with it.

    Exit status 1 if a check failed.

    Parameters
    ----------
    plugin
        Registered name, KIND:NAME if two kinds share a name (effect:mass), or module:Class.
    setting
        Setting of a method, such as trainer.epochs=3; may be repeated.
    simulator
        Only this simulator: effects are attached to it, methods deployed in it.
    """
    check_registered(plugin)
    check_names("simulator", simulator or ())
    compute_here()
    from bench.conformance.command import check as check_plugin

    return check_plugin(plugin, setting or (), simulator or ())
