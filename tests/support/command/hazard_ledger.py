"""Counts which hazards had a passing test; with `--every-hazard` a hazard without one fails the run.

What the trace matrix reads in the source is a promise. This is what became of it: a test that was skipped for
want of a program, or that nobody ran, controls nothing.
"""

from __future__ import annotations

from collections.abc import Generator

import pytest
from hazard_matrix import read_hazards

OPTION = "--every-hazard"
PROPERTY = "hazard"  # travels with a report from the worker that ran the test


class HazardLedger:
    """Where the reports of all workers arrive."""

    def __init__(self, demanded: frozenset[int]) -> None:
        self._demanded = demanded
        self._passed: set[int] = set()

    @property
    def without_a_passing_test(self) -> list[int]:
        """Numbers of the hazards that no passing test was bound to."""
        return sorted(self._demanded - self._passed)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call" and report.passed:
            self._passed |= {int(str(value)) for name, value in report.user_properties if name == PROPERTY}

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if self.without_a_passing_test and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        if missing := self.without_a_passing_test:
            terminalreporter.section("hazards without a passing test", red=True)
            terminalreporter.line(", ".join(map(str, missing)))


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(OPTION, action="store_true", help="fail unless each hazard has a test that passed")


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption(OPTION) and not hasattr(config, "workerinput"):
        demanded = frozenset(one.number for one in read_hazards())
        config.pluginmanager.register(HazardLedger(demanded), "hazard_ledger_of_all_workers")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    report.user_properties += [(PROPERTY, mark.args[0]) for mark in item.iter_markers(PROPERTY)]
    return report
