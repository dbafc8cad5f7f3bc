"""Fails a test session in which something was skipped for a reason that is not known.

`--known-skips-only` (`.ci/run`) turns it on. A test that is skipped on every machine rots unseen,
as one of Ray's did; so each reason stands here, with what would make the test run.
"""

import re

import pytest

KNOWN = {
    r"The real flights are not beside the repository": "they are too large for git",
    r"needs Chromium or Chrome on the PATH": "apt-get could not install chromium; .ci/run says so",
    r"needs axe-core in node_modules": "npm could not install it; .ci/run says so",
    r"Ray is not installed": "pip could not install the extra `ray`; .ci/run says so",
    r"submitit is not installed": "pip could not install the extra `slurm`; .ci/run says so",
    r"(pyulog|rosbags|pymavlink) is not installed": "pip could not install the extras `ulog`, "
    "`ros`, `ardupilot`; .ci/run says so",
    r"(tensorboardX|mlflow|sqlalchemy|alembic|wandb|mlcroissant) is not installed": "pip could not "
    "install the extras `tensorboard`, `mlflow`, `wandb`, `croissant`; .ci/run says so",
    r"This file system takes UTF-8 names only": "not every file system takes any bytes as a name",
    r"cores cannot be chosen here": "Linux alone lets a process choose its cores",
}
"""Reasons for which a test may be skipped (regular expressions), each with why it cannot be run."""


def reason_of(report: pytest.TestReport | pytest.CollectReport) -> str:
    """Why a test, or a whole file, was skipped."""
    text = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    return text.removeprefix("Skipped: ")


def is_known(reason: str) -> bool:
    """Whether `KNOWN` lists the reason."""
    return any(re.search(pattern, reason) for pattern in KNOWN)


class SkipsCount:
    """Collects skipped tests; the session fails if one was skipped for no known reason."""

    def __init__(self) -> None:
        self.unknown: list[str] = []

    def _add(self, report: pytest.TestReport | pytest.CollectReport) -> None:
        # An expected failure is reported as skipped, too, and is none.
        if report.skipped and not hasattr(report, "wasxfail"):
            reason = reason_of(report)
            if not is_known(reason):
                self.unknown.append(f"{report.nodeid}: {reason}")

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """One phase of a test ended."""
        self._add(report)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """A file was collected."""
        self._add(report)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Sets the exit status."""
        if self.unknown and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Names what was skipped."""
        if self.unknown:
            terminalreporter.section("skipped for a reason that tests/skips.py does not list")
            for line in self.unknown:
                terminalreporter.line(line)
