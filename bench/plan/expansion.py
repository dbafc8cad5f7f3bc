"""Expands a suite into runs: what each one is, what it needs, and the key it is stored under.

A run's key is a hash of everything that determines its result: resolved settings of its method,
task, residual and simulators (defaults included), their declared versions, the keys of its
parents, and the numerics. Equal keys mean that a stored result can be used again.

A parent, such as the LF baseline that a hot start begins from, is the run with the same task, task
settings, team size and seed, and that method's default settings; a method may fix another task and
team size (`AbstractMethod.parent_cells`). It is planned even if the suite does not ask for it.
"""

import dataclasses
import functools
import importlib.metadata
import json
from collections.abc import Iterable, Mapping
from typing import Any

import jax

from bench.plan import settings
from bench.plan.keys import Setting
from bench.plan.planned_run import REALITY, Run
from bench.plan.realities import EFFECTS, NOMINAL, nominal_simulator, parse_reality, written
from bench.plan.sources import own_source, shared_sources
from bench.plan.suite import Row, Suite
from bench.text.errors import UsageError
from methods.calibration.reference_paths import Followers
from methods.contract import AbstractMethod
from methods.training.evaluate import TUNING_SEEDS, Evaluation
from simulators import registry
from simulators.contract import AbstractSimulator
from simulators.drawn.drawn_team import Drawn, DrawnState
from simulators.effects.chain import Effects, canonical
from simulators.tracking import PDTracker

PROTOCOL = "2"
"""Version of what all runs share and no plug-in's version tells: trainer, rollout, contacts,
evaluation (`reports/protocol.md`). It is part of every key."""
PACKAGES = (
    *("fidelity-bench", "jax", "equinox", "optax", "scipy", "pysindy"),
    *("crazyflow", "mujoco", "rotorpy"),
)
"""Installed packages whose versions are recorded with a run; they are not part of its key."""


class PlanError(UsageError):
    """A suite that cannot be planned; the message is one line."""


@dataclasses.dataclass(frozen=True)
class Plan:
    """What a suite comes to."""

    runs: list[Run]
    """Every run once, parents before their children."""
    broken: list[str]
    """What was left out because a plug-in cannot be imported, one line each."""


def expand(suite: Suite) -> Plan:
    """All runs of a suite, with the parents that they need.

    Raises:
        PlanError: A row fits no method, methods need each other, or seeds are mixed with tuning's.
        SettingsError: A method or task does not have or accept a setting.
        UnknownPluginError: A method needs a parent that is not registered.
    """
    if suite.first_seed < TUNING_SEEDS < suite.first_seed + suite.seeds:
        raise PlanError(
            f"Seeds must lie below {TUNING_SEEDS} or from there on, where settings are tuned and "
            "policies are evaluated from other initial states; "
            f"got {suite.first_seed} to {suite.first_seed + suite.seeds - 1}."
        )
    runs: dict[str, Run] = {}
    recipes: dict[tuple, _Recipe] = {}
    broken: dict[str, None] = {}
    for row in suite.methods:
        n_seeds = min(suite.seeds, row.seeds or suite.seeds)
        for task in suite.tasks if row.tasks is None else row.tasks:
            for team_size in suite.team_sizes if row.team_sizes is None else row.team_sizes:
                if task not in suite.tasks or team_size not in suite.team_sizes:
                    continue  # a restricted row keeps within what the command line chose
                try:
                    recipe = _recipe(recipes, row, task, team_size, ())
                except registry.BrokenPluginError as error:
                    broken[str(error)] = None
                    continue
                for seed in range(suite.first_seed, suite.first_seed + n_seeds):
                    _add(runs, recipe, seed)
    if not runs:
        reason = next(iter(broken), "its rows are restricted to other tasks or team sizes.")
        raise PlanError(f"Suite '{suite.name}' has nothing to run: {reason}")
    _check_identities(runs.values())
    return Plan(list(runs.values()), list(broken))


def _check_identities(runs: Iterable[Run]) -> None:
    """Raises PlanError if tables could not tell two runs apart (`simulator` is in no variant)."""
    taken: dict[tuple, str] = {}
    for run in runs:
        if taken.setdefault(run.identity, run.name) != run.name:
            raise PlanError(
                f"Method '{run.method}' is planned twice on {run.task} with {run.team_size} drones "
                f"as '{run.variant or 'default'}', in two ways that tables do not tell apart. Put "
                "rows of another `simulator` into a suite and a folder of their own."
            )


@dataclasses.dataclass(frozen=True)
class _Recipe:
    """The runs of a row in one cell, whatever their seed: what is slow is done once for all."""

    resolved: Mapping[str, Setting]
    """What determines a result, but for the seed and the parents."""
    given: Mapping[str, Any]
    """The other fields of its runs."""
    parents: "Mapping[str, _Recipe]"
    """Recipe of each parent, by method."""
    made: dict[int, Run] = dataclasses.field(default_factory=dict)
    """Runs by seed, each made once."""

    def run(self, seed: int) -> Run:
        """The run with that seed."""
        if seed not in self.made:
            parents = {name: recipe.run(seed) for name, recipe in self.parents.items()}
            keys = {name: parent.key for name, parent in parents.items()}
            self.made[seed] = Run(
                seed=seed,
                parents={name: parent.name for name, parent in parents.items()},
                resolved={**self.resolved, "seed": seed, "parents": keys},
                **self.given,
            )
        return self.made[seed]


def _add(runs: dict[str, Run], recipe: _Recipe, seed: int) -> None:
    """Puts the parents of a run and then the run itself into `runs`."""
    for parent in recipe.parents.values():
        _add(runs, parent, seed)
    run = recipe.run(seed)
    runs.setdefault(run.name, run)


def _recipe(
    recipes: dict[tuple, _Recipe], row: Row, task: str, team_size: int, children: tuple[str, ...]
) -> _Recipe:
    """The recipe of a row in one cell; the same one for rows that say the same."""
    if row.method in children:
        circle = " -> ".join((*children[children.index(row.method) :], row.method))
        raise PlanError(f"These methods need each other as parents: {circle}.")
    chosen = (row.settings, row.task_settings, row.nominal)
    texts = (json.dumps(s, sort_keys=True, default=repr) for s in chosen)
    flying = (row.simulator, row.world, row.deploys, row.tracked)
    index = (row.method, row.residual, *texts, *flying, task, team_size)
    if index not in recipes:
        method_class = _method(row.method)
        if row.deploys:
            trained = dataclasses.replace(row, deployed_in="", tracked=False)
            parents = {row.method: _recipe(recipes, trained, task, team_size, children)}
        else:
            descent = (*children, row.method)
            parents = {
                name: _recipe(recipes, *_parent(method_class, name, row, task, team_size), descent)
                for name in method_class.parents
            }
        recipes[index] = _make_recipe(row, method_class, task, team_size, parents)
    return recipes[index]


def _parent(
    method_class: type[AbstractMethod], name: str, row: Row, task: str, team_size: int
) -> tuple[Row, str, int]:
    """The row and the cell of a parent: the child's own, unless its class fixes another."""
    reality = row.reality if method_class.parents_fly_reality else ""
    parent = Row(name, nominal=row.nominal, simulator=row.simulator, reality=reality)
    if name in method_class.parent_cells:
        return parent, *method_class.parent_cells[name]
    return dataclasses.replace(parent, task_settings=row.task_settings), task, team_size


def _method(name: str) -> type[AbstractMethod]:
    """The class of a method, of which nothing but the plug-in itself says that it is one."""
    found = registry.load("method", name)
    if isinstance(found, type) and issubclass(found, AbstractMethod) and hasattr(found, "parents"):
        return found
    raise PlanError(
        f"Method '{name}' must be a class that implements AbstractMethod; "
        f"`bench check method:{name}` says what is wrong."
    )


def _make_recipe(
    row: Row, method_class: type, task: str, team_size: int, parents: Mapping[str, _Recipe]
) -> _Recipe:
    residual = _residual(row, method_class)
    given = {"residual": residual} if residual else {}
    where = f"Method '{row.method}'"
    method = _describe(method_class, row.settings, where, **given)
    default_method = _describe(method_class, {}, where, **given)
    task_class, where = registry.load("task", task), f"Task '{task}'"
    team = {"n_drones": team_size}
    flown = _describe(task_class, row.task_settings, where, **team)
    default_task = _describe(task_class, {}, where, **team)
    (nominal, changed, added), reality = _nominal(row), _reality(row)
    found = _plugins({"method": row.method, "task": task, "residual": residual}, reality, added)
    home = row.simulator or REALITY
    flying = _flying(row, reality, home)
    resolved = {
        "protocol": PROTOCOL,
        "method": row.method,
        "residual": residual,
        "settings": method,
        "task": task,
        "task_settings": flown,
        "versions": {plugin: _version(plugin, cls) for plugin, cls in found.items()},
        "defaults": {
            plugin: _defaults(plugin, cls)
            for plugin, cls in found.items()
            if plugin.split()[0] in ("residual", "simulator")
        }
        | {f"simulator {NOMINAL}": nominal},
        "numerics": {
            "x64": bool(jax.config.read("jax_enable_x64")),
            "backend": jax.default_backend(),
        },
    }
    resolved |= flying | ({"deploys": True} if row.deploys else {})
    resolved |= {"simulator": home} if home != REALITY else {}
    candidates = registry.load_all("effect").values() if method_class.identifies else ()
    others = flying | ({"nominal": changed} if changed else {})
    if row.tracked:  # the key is of the controller's settings, the variant says only that it flies
        resolved["tracked"] = settings.describe_fields(PDTracker(), "The PD controller")
    given = {
        "method": row.method,
        "residual": residual,
        "variant": settings.variant((method, default_method), (flown, default_task), (others, {})),
        "task": task,
        "team_size": team_size,
        "overrides": row.settings,
        "task_overrides": row.task_settings,
        "nominal_overrides": row.nominal,
        "sources": _sources(
            found
            | {"evaluation": Evaluation}
            | ({"controller": Followers} if row.tracked else {})
            | {f"effect {cls.__name__}": cls for cls in candidates}
        ),
        "cost": 0.5 if row.deploys else _cost(method_class, team_size),
        "reality": row.world or REALITY,
        "deploys": row.deploys,
        "tracked": row.tracked,
    }
    return _Recipe(resolved, given, parents)


def _plugins(
    names: Mapping[str, str], reality: AbstractSimulator, added: Effects
) -> dict[str, type]:
    """Every class that decides a result, by its kind and name.

    Args:
        names: Method, task and residual by kind; empty for none.
        reality: Where the policy is deployed.
        added: Effects of the low-fidelity simulator.
    """
    chosen = [(kind, name) for kind, name in names.items() if name]
    chosen += [("simulator", NOMINAL), ("simulator", reality.name)]
    found = {f"{kind} {name}": registry.load(kind, name) for kind, name in chosen}
    effects = map(type, (*reality.effects, *added))
    found |= {f"effect {effect.__name__}": effect for effect in effects}
    return found | ({"drawn team": DrawnState} if isinstance(reality, Drawn) else {})


def _flying(row: Row, reality: AbstractSimulator, home: str) -> dict[str, Setting]:
    """What of a row's deployment is not as by default: another world than `home`, a controller.

    Raises:
        PlanError: It only deploys a policy, and everything is as by default.
    """
    place = written(reality)
    if row.deploys and not row.tracked and place == home:
        raise PlanError(
            f"Method '{row.method}': `deployed_in` must name an effect, such as "
            f"'{home}+mass(e=0.2)', or another simulator. Leave it out to deploy in {home} without "
            "effects."
        )
    flying: dict[str, Setting] = {}
    if place != home:
        flying["deployed_in" if row.deploys else "reality"] = place
    if row.tracked:
        flying["tracked"] = True
    return flying


def _nominal(row: Row) -> tuple[dict[str, Setting], dict[str, Setting], Effects]:
    """The low-fidelity simulator of a row as JSON, what of it is not as by default, its effects."""
    default = _defaults(f"simulator {NOMINAL}", registry.load("simulator", NOMINAL))
    if not row.nominal:
        return default, {}, ()
    simulator = nominal_simulator(row.nominal)
    described, given = settings.describe_fields(simulator, NOMINAL), dict(row.nominal)
    if simulator.effects:
        described[EFFECTS] = given[EFFECTS] = canonical(simulator.effects)
    changed = {name: x for name, x in given.items() if described[name] != default[name]}
    return described, changed, simulator.effects


def _reality(row: Row) -> AbstractSimulator:
    """Where a row is deployed.

    Raises:
        PlanError: It is the low-fidelity simulator.
        UsageError: It is not understood.
    """
    key = next((k for k in ("reality", "deployed_in") if getattr(row, k)), "simulator")
    where = f"Method '{row.method}', `{key}`"
    reality = parse_reality(row.world or REALITY, where)
    if reality.name == NOMINAL:
        raise PlanError(
            f"{where}: the simulator must be a high-fidelity one, got '{NOMINAL}', in which "
            "policies are trained."
        )
    return reality


def _describe(
    cls: type, overrides: Mapping[str, Setting], where: str, **given: Setting
) -> dict[str, Setting]:
    """All fields of a plug-in as JSON, with some overridden."""
    return settings.describe_fields(settings.build(cls, overrides, where, **given), where)


def _residual(row: Row, method_class: type) -> str:
    """Name of the residual that a row trains with, empty if its method takes none."""
    field = {f.name: f for f in dataclasses.fields(method_class)}.get("residual")
    if field is None:
        if row.residual:
            raise PlanError(f"Method '{row.method}' takes no residual, got '{row.residual}'.")
        return ""
    if "residual" in row.settings:
        raise PlanError(
            f"Method '{row.method}': give `residual` beside `method`, not among the settings."
        )
    if not row.residual and not isinstance(field.default, str | None):
        raise PlanError(
            f"Method '{row.method}' needs a `residual`: {', '.join(registry.names('residual'))}."
        )
    return row.residual or str(field.default or "")


def _version(plugin: str, cls: type) -> str:
    """The version that a plug-in declares."""
    if not isinstance(version := getattr(cls, "version", None), str):
        raise PlanError(f"Plug-in '{plugin}' must have a class attribute `version`, such as '1'.")
    return version


@functools.cache
def _defaults(plugin: str, cls: type) -> dict[str, Setting]:
    """All fields of a plug-in as JSON."""
    return _describe(cls, {}, f"Plug-in '{plugin}'")


def _sources(found: Mapping[str, type]) -> dict[str, str]:
    """Hashes of the code that plug-ins run: theirs by plug-in, what they import by module."""
    own = {plugin: own_source(cls) for plugin, cls in found.items()}
    shared = shared_sources(found.values())
    return own | {f"module {name}": source for name, source in shared.items()}


def packages() -> dict[str, str]:
    """Versions of the installed packages that matter to a result."""
    return {name: importlib.metadata.version(name) for name in PACKAGES}


def _cost(method_class: type, team_size: int) -> float:
    """A guess from measured runs: HF training costs most, then what trains on top of a parent."""
    if method_class.simulator == REALITY and not method_class.parents:
        return 6.0 * (2 + team_size)
    return (3.0 if method_class.parents else 1.0) * (2 + team_size)
