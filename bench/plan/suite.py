"""What a suite asks for: tasks, team sizes, seeds and method rows, read from TOML and checked.

    name = "mine"                      # the file's name where it is missing
    description = "One line."
    tasks = ["spread", "circle"]
    team_sizes = [3, 12]
    seeds = 3                          # seeds 0, 1 and 2
    first_seed = 0                     # settings are tuned on seeds from 1000 on
    simulator = "crazyflow"            # the high-fidelity one; "rotorpy" is another

    [[methods]]
    method = "hybrid"
    residual = "mlp"                   # for methods that take one
    settings.trainer.epochs = 200      # fields of the method
    task_settings.observe_attitude = true
    nominal.attitude_tau = 0.05        # fields of the low-fidelity simulator, its parents' too
    nominal.effects = "floor(height=0)"    # effects of the low-fidelity simulator
    reality = "crazyflow+mass(e=0.2)"  # what it is trained for and deployed in; of a list, each
    tasks = ["circle"]                 # this row only on these
    team_sizes = [12]
    seeds = 1

    [[methods]]
    method = "lf_baseline"
    deployed_in = "crazyflow+wind(x=1.5)"  # as it is: this row trains nothing
    tracked = true                     # a PD controller flies the paths of that policy

    [quick]                            # what `bench run SUITE --quick` leaves of it
    tasks = ["circle"]
    team_sizes = [3]
    seeds = 1
    methods = ["lf_baseline", "hybrid"]
    residuals = ["mlp"]                # of the methods that take one

An unknown key is an error, and so is a row outside the suite's own tasks, team sizes and seeds.
Plug-in names are checked without importing any plug-in.
"""

import dataclasses
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

import pydantic

from bench.plan.keys import Setting
from bench.plan.names import require
from bench.plan.toml_table import SuiteError, read_table
from simulators import registry

BUILT_IN = Path(__file__).parent / "suites"
"""Where the built-in suites are."""
Settings: TypeAlias = Mapping[str, pydantic.SkipValidation[Setting]]
"""Fields to override; planning checks them against the plug-in's class."""
NO_OTHER_KEYS = pydantic.ConfigDict(extra="forbid")
"""A misspelt key in a file is an error."""


@pydantic.with_config(NO_OTHER_KEYS)
@dataclasses.dataclass(frozen=True)
class Row:
    """One method to compare."""

    method: str
    """Registered name."""
    residual: str = ""
    """Registered name of the residual; empty: the method's default, or none."""
    settings: Settings = dataclasses.field(default_factory=dict)
    """Fields of the method to override."""
    task_settings: Settings = dataclasses.field(default_factory=dict)
    """Fields of the task to override."""
    nominal: Settings = dataclasses.field(default_factory=dict)
    """Fields of the low-fidelity simulator to override, for the row and for its parents."""
    simulator: str = ""
    """High-fidelity simulator that stands for the real world, for the row and for its parents;
    empty: crazyflow."""
    reality: str = ""
    """Another reality, a simulator and its effects, for which it is trained and in which it is
    deployed; empty: `simulator` without effects. Its parents know `simulator`, unless its method
    says otherwise (`AbstractMethod.parents_fly_reality`)."""
    deployed_in: str = ""
    """The same for a row that trains nothing: what it would train without this key is deployed."""
    tracked: pydantic.StrictBool = False
    """Whether a PD controller flies what that policy flies in the nominal simulator, instead of the
    policy; such a row trains nothing either."""
    tasks: tuple[str, ...] | None = None
    """Tasks to which the row is restricted; None: all of the suite."""
    team_sizes: tuple[pydantic.StrictInt, ...] | None = None
    """Team sizes to which the row is restricted; None: all of the suite."""
    seeds: pydantic.StrictInt | None = None
    """Number of seeds to which the row is restricted; None: all of the suite."""

    @property
    def deploys(self) -> bool:
        """Whether it trains nothing and deploys what the row would train otherwise."""
        return bool(self.deployed_in) or self.tracked

    @property
    def world(self) -> str:
        """Where it is deployed; empty: in crazyflow without effects."""
        return self.reality or self.deployed_in or self.simulator


@pydantic.with_config(NO_OTHER_KEYS)
@dataclasses.dataclass(frozen=True)
class QuickPart:
    """A small part of a suite that shows what the whole is about."""

    tasks: tuple[str, ...]
    """Registered names, among the suite's."""
    team_sizes: tuple[pydantic.StrictInt, ...]
    """Numbers of drones, among the suite's."""
    seeds: pydantic.StrictInt
    """Number of seeds, at most the suite's."""
    methods: tuple[str, ...]
    """Registered names, among those of the suite's rows."""
    residuals: tuple[str, ...]
    """Registered names: rows with another residual are left out, rows without one stay."""


@pydantic.with_config(NO_OTHER_KEYS)
@dataclasses.dataclass(frozen=True)
class Suite:
    """A product of tasks, team sizes, seeds and method rows."""

    name: str
    """Names the folders of its results."""
    description: str
    """One line."""
    tasks: tuple[str, ...]
    """Registered names."""
    team_sizes: tuple[pydantic.StrictInt, ...]
    """Numbers of drones, each at least 2."""
    seeds: pydantic.StrictInt
    """Number of seeds."""
    methods: tuple[Row, ...]
    """What is compared."""
    first_seed: pydantic.StrictInt = 0
    """Seeds `first_seed` to `first_seed + seeds - 1` are run."""
    simulator: str = ""
    """High-fidelity simulator of the rows that name none; empty: crazyflow."""
    quick: QuickPart | None = None
    """What is left of it where there is little time; None: it has no such part."""

    def __post_init__(self) -> None:
        where = f"Suite '{self.name}'"
        if not re.fullmatch(r"\w[\w.-]*", self.name):
            raise SuiteError(
                f"A suite's name must be made of letters, digits, '_', '-' and '.', because it "
                f"names a folder, got '{self.name}'."
            )
        if self.seeds < 1:
            raise SuiteError(f"`seeds` must be at least 1, got {self.seeds}.")
        if self.first_seed < 0:
            raise SuiteError(f"`first_seed` must be at least 0, got {self.first_seed}.")
        if self.first_seed + self.seeds > 2**32:
            raise SuiteError(
                f"The last seed, `first_seed` + `seeds` - 1, must be at most {2**32 - 1}, "
                f"got {self.first_seed + self.seeds - 1}."
            )
        for name in ("tasks", "team_sizes", "methods"):
            if not getattr(self, name):
                raise SuiteError(f"{where}: `{name}` must not be empty.")
        _check_names(self.tasks, self.team_sizes)
        for row in self.methods:
            require("method", row.method)
            for kind, name in (("residual", row.residual), ("simulator", row.simulator)):
                if name:
                    require(kind, name)
            _check_names(row.tasks or (), row.team_sizes or ())
            if row.reality and row.deploys:
                raise SuiteError(
                    f"{where}: give `reality` to train for it, or `deployed_in` and `tracked` to "
                    "deploy what is trained without them, but not both."
                )
            if row.seeds is not None and row.seeds < 1:
                raise SuiteError(f"{where}: `seeds` of a row must be at least 1, got {row.seeds}.")

    def quickly(self) -> "Suite":
        """Its quick part: the same runs, fewer of them.

        Raises:
            SuiteError: It has none.
        """
        if self.quick is None:
            able = [name for name in built_in() if load_suite(name).quick is not None]
            raise SuiteError(
                f"Suite '{self.name}' has no table [quick]. Suites that have one: "
                f"{', '.join(able)}. Or choose a part with --task, --team-size, --method, --seeds."
            )
        part = self.quick
        rows = (row for row in self.methods if row.method in part.methods)
        return dataclasses.replace(
            self,
            tasks=part.tasks,
            team_sizes=part.team_sizes,
            seeds=part.seeds,
            methods=tuple(r for r in rows if not r.residual or r.residual in part.residuals),
        )

    def deploying(self) -> "Suite":
        """The suite with the rows that train nothing.

        Raises:
            SuiteError: It has none.
        """
        rows = tuple(row for row in self.methods if row.deploys)
        if not rows:
            raise SuiteError(
                f"Every row of suite '{self.name}' trains; --deployed takes those with "
                "`deployed_in` or `tracked`."
            )
        return dataclasses.replace(self, methods=rows)

    def select(
        self,
        tasks: Sequence[str] = (),
        team_sizes: Sequence[int] = (),
        methods: Sequence[str] = (),
        residuals: Sequence[str] = (),
        seeds: int | None = None,
    ) -> "Suite":
        """The suite with what the command line chose instead of its own lists.

        A task, team size or method need not be in the suite; such a method gets a row with
        default settings. `residuals` keeps rows with one of these and fills in rows that name none
        but could; of methods that take none, it keeps those that `methods` names.

        Raises:
            SuiteError: Nothing is left, or something chosen is not allowed.
            UnknownPluginError: A chosen name is not registered.
        """
        for residual in residuals:
            require("residual", residual)
        rows = [row for row in self.methods if not methods or row.method in methods]
        known = {row.method for row in rows}
        rows += [
            Row(method, simulator=self.simulator)
            for method in dict.fromkeys(methods)
            if method not in known
        ]
        if residuals:
            rows = [kept for row in rows for kept in _filled(row, residuals, row.method in methods)]
            rows += [
                Row(method, residual, simulator=self.simulator)
                for method in dict.fromkeys(r.method for r in self.methods if r.residual)
                if not methods or method in methods
                for residual in dict.fromkeys(residuals)
                if residual not in {row.residual for row in rows if row.method == method}
            ]
        if not rows:
            raise SuiteError(
                f"The filters leave no run of suite '{self.name}'. Give fewer of them."
            )
        return dataclasses.replace(
            self,
            tasks=tuple(dict.fromkeys(tasks)) or self.tasks,
            team_sizes=tuple(dict.fromkeys(team_sizes)) or self.team_sizes,
            seeds=self.seeds if seeds is None else seeds,
            methods=tuple(rows),
        )


def _filled(row: Row, residuals: Sequence[str], named: bool) -> list[Row]:
    """What is left of a row where residuals are chosen; `named`: its method is chosen, too."""
    if row.residual:
        return [row] if row.residual in residuals else []
    try:
        cls = registry.load("method", row.method)
    except registry.BrokenPluginError:
        return [row] if named else []  # planning says why
    if any(field.name == "residual" for field in dataclasses.fields(cls)):
        return [dataclasses.replace(row, residual=name) for name in dict.fromkeys(residuals)]
    return [row] if named else []


def built_in() -> list[str]:
    """Names of the built-in suites, smallest first."""
    order = ["quick", "paper"]
    names = {path.stem for path in BUILT_IN.glob("*.toml")}
    return sorted(names, key=lambda n: (order.index(n) if n in order else len(order), n))


def load_suite(name: str) -> Suite:
    """The suite of that built-in name, or in the TOML file at that path.

    Raises:
        SuiteError: There is no such suite or it is not written as it must be.
        UnknownPluginError: It names a task, method or residual that is not registered.
    """
    path = BUILT_IN / f"{name}.toml" if name in built_in() else Path(name)
    if not path.is_file():
        if path.suffix == ".toml":
            raise SuiteError(f"There is no suite file '{name}'.")
        raise SuiteError(
            registry.unknown("suite", name, built_in()) + " Or give the path of a TOML file."
        )
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SuiteError(f"{path} cannot be read: {' '.join(str(error).split())}") from error
    return _parse(content, path)


def _parse(content: Mapping[str, Setting], path: Path) -> Suite:
    where = f"Suite '{path.stem}'"
    simulator, tables = content.get("simulator"), content.get("methods")
    shared = {"simulator": simulator} if isinstance(simulator, str) else {}
    rows: list[tuple[str, Row]] = []
    for number, table in enumerate(tables if isinstance(tables, list) else (), start=1):
        place = f"{where}, method {number}"
        rows += [(place, read_table(Row, row, place)) for row in _one_a_world(table, shared)]
    given: dict[str, object] = {"name": path.stem, "description": "", **content}
    if isinstance(tables, list):
        given["methods"] = [row for _, row in rows]
    if "quick" in content:
        given["quick"] = read_table(QuickPart, content["quick"], f"{where}, [quick]")
    suite = read_table(Suite, given, where)
    for place, row in rows:
        _check_within(suite, row, place)
    if suite.quick is not None:
        _check_quick(suite, suite.quick, f"{where}, [quick]")
    return suite


def _one_a_world(table: object, shared: Mapping[str, object]) -> Sequence[object]:
    """The table of a row over what all rows share, once for each of the worlds that it lists."""
    if not isinstance(table, dict):
        return [table]
    rows = [{**shared, **table}]
    for key in ("reality", "deployed_in"):
        if isinstance(table.get(key), list):
            rows = [{**row, key: world} for row in rows for world in table[key]]
    return rows


def _check_quick(suite: Suite, part: QuickPart, where: str) -> None:
    _check_within(suite, part, where)
    for residual in part.residuals:
        require("residual", residual)
    known = {row.method for row in suite.methods}
    for method in part.methods:
        require("method", method)
        if method not in known:
            raise SuiteError(f"{where}: `methods` must be among the suite's, got {method!r}.")


def _check_within(suite: Suite, row: Row | QuickPart, where: str) -> None:
    for key, asked in (("tasks", row.tasks), ("team_sizes", row.team_sizes)):
        for value in asked or ():
            if value not in getattr(suite, key):
                raise SuiteError(
                    f"{where}: `{key}` must be among the `{key}` of the suite, got {value!r}."
                )
    if row.seeds is not None and row.seeds > suite.seeds:
        raise SuiteError(
            f"{where}: `seeds` must be at most the suite's {suite.seeds}, got {row.seeds}."
        )


def _check_names(tasks: Sequence[str], team_sizes: Sequence[int]) -> None:
    for task in tasks:
        require("task", task)
    for size in team_sizes:
        if size < 2:
            raise SuiteError(f"A team size must be at least 2, got {size}.")
