"""Building blocks of the conformance suites: numbered cases, their requirements, and their checks."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol, TypeVar

from conformance.device_under_test import DeviceUnderTest
from conformance.errors import NO_SUCH_CASE
from ronna_hw.errors import AnyCode, AnyError, is_error


@dataclass(frozen=True)
class Need:
    """Requirement of a case on the device under test, and the reason reported when the case is skipped."""

    name: str
    reason: str


MOTION = Need("motion", "it moves the device: allow it with --allow motion")
DESTRUCTIVE = Need(
    "destructive", "it resets the device or changes its settings: allow it with --allow destructive"
)
OUTPUT = Need(
    "output", "it switches an output line, and a laser that is wired to it: allow it with --allow output"
)
LINE_FAULTS = Need("line faults", "no proxy can be put between this driver and this endpoint")
CHECKED_REPLIES = Need("checked replies", "the driver's wire protocol has no known checksums")
HOST_TIME = Need("host time", "the theatre's clock is not the host's")


class CaseOutcome(StrEnum):
    """Outcome of a conformance case."""

    PASS = "PASS"
    FAIL = "FAIL"
    SKIP = "SKIP"


class NotShown(Exception):
    """The case cannot be decided on this device, for example because no stray is in view."""


class Nonconformity(AssertionError):
    """The device does not behave as the case states."""


Run = Callable[[DeviceUnderTest], object]
S = TypeVar("S")
Decorator = Callable[[Callable[[S], object]], Callable[[S], object]]


class CaseOf(Protocol[S]):
    """Decorator like `CaseList.case`, for functions that check a subject instead of a device under test."""

    def __call__(self, number: str, statement: str, *, needs: tuple[Need, ...] = ()) -> Decorator[S]: ...


@dataclass(frozen=True)
class SuiteCase:
    """Required behaviour with a stable case number.

    T, R and S cases apply to any tracker, robot or stereo pair; the other letters belong to a wire protocol.
    """

    number: str
    statement: str
    needs: tuple[Need, ...]
    run: Run


class CaseList:
    """Conformance cases in order of definition."""

    def __init__(self, cases: Iterable[SuiteCase] = ()) -> None:
        self.cases = list(cases)

    def case(self, number: str, statement: str, *, needs: tuple[Need, ...] = ()) -> Callable[[Run], Run]:
        """Register the decorated function as a case; raises ValueError if the number is already in use."""
        if any(other.number == number for other in self.cases):
            raise ValueError(f"two cases have number {number}")

        def add(run: Run) -> Run:
            self.cases.append(SuiteCase(number, statement, needs, run))
            return run

        return add

    def with_each(self, subjects: Callable[[DeviceUnderTest], Iterable[S]]) -> CaseOf[S]:
        """Return a variant of `case` whose function checks one subject, such as a camera, at a time."""

        def check_each(dut: DeviceUnderTest, check_one: Callable[[S], object]) -> None:
            for subject in subjects(dut):
                check_one(subject)

        return self._case_of(check_each)

    def within(
        self, context: Callable[[DeviceUnderTest], AbstractContextManager[S]], *needs: Need
    ) -> CaseOf[S]:
        """Return a variant of `case` whose function runs inside a context with additional needs."""

        def check_within(dut: DeviceUnderTest, check_one: Callable[[S], object]) -> None:
            with context(dut) as subject:
                check_one(subject)

        return self._case_of(check_within, needs)

    def _case_of(
        self,
        run: Callable[[DeviceUnderTest, Callable[[S], object]], None],
        context_needs: tuple[Need, ...] = (),
    ) -> CaseOf[S]:
        def case(number: str, statement: str, *, needs: tuple[Need, ...] = ()) -> Decorator[S]:
            def add(check_one: Callable[[S], object]) -> Callable[[S], object]:
                self.case(number, statement, needs=(*context_needs, *needs))(lambda dut: run(dut, check_one))
                return check_one

            return add

        return case


class Suite(CaseList):
    """All cases for one kind of device.

    `driver` is tested unless another is named; `motions` describes what the cases that need "motion" move.
    """

    def __init__(self, kind: str, driver: str, *, motions: str = "", cases: Iterable[SuiteCase] = ()) -> None:
        super().__init__(cases)
        self.kind = kind
        self.driver = driver
        self.motions = motions

    def with_cases(self, cases: Iterable[SuiteCase]) -> Suite:
        """Return a suite of the same kind with these cases."""
        return Suite(self.kind, self.driver, motions=self.motions, cases=cases)

    def list_moving_cases(self) -> list[str]:
        return [case.number for case in self.cases if MOTION in case.needs]

    def only(self, prefixes: Sequence[str]) -> Suite:
        """Select the cases whose numbers start with one of `prefixes`, by default all; raises CNF-003."""
        if not prefixes:
            return self
        cases = [case for case in self.cases if case.number.startswith(tuple(prefixes))]
        if not cases:
            families = dict.fromkeys(case.number[0] for case in self.cases)
            raise NO_SUCH_CASE(
                f"--only: no case of the {self.kind} suite starts with {' or '.join(prefixes)}",
                expected=f"a number that starts with {' or '.join(families)}",
            )
        return self.with_cases(cases)


def check(condition: bool, expected: str, found: object = "") -> None:
    """Raise Nonconformity with expected and actual behaviour unless `condition` holds."""
    if not condition:
        raise Nonconformity(f"expected {expected}" + (f", got {found}" if found != "" else ""))


def require_present(value: S | None, expected: str, found: object = "") -> S:
    """Return the value; raises Nonconformity if it is None."""
    check(value is not None, expected, found)
    assert value is not None, "check has raised"
    return value


@contextmanager
def read_as(expected: str) -> Iterator[None]:
    """Raise Nonconformity if the block cannot decode the device's bytes as `expected`.

    Also a decorator.
    """
    try:
        yield
    except (ValueError, OverflowError, struct.error) as error:
        raise Nonconformity(f"expected {expected}, got {error}") from error


def refused(call: Callable[[], object], expected: AnyCode[AnyError], what: str) -> AnyError:
    """Return the error that `call` must raise; raises Nonconformity if it does not."""
    name, kind = (
        (expected.__name__, expected) if isinstance(expected, type) else (expected.code, expected.kind)
    )
    try:
        call()
    except Exception as error:
        if isinstance(error, kind) and is_error(error, expected):
            return error
        raise Nonconformity(f"expected {what} to raise {name}, got {error!r}") from error
    raise Nonconformity(f"expected {what} to raise {name}, but it was carried out")
