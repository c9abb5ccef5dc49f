"""Cases: small functions with a number, a statement of behaviour, and what they need to be run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING

from ronna_hw.conformance.errors import NoSuchCase

if TYPE_CHECKING:
    from ronna_hw.conformance.device_under_test import DeviceUnderTest

# What a case may need, and why it is left out when that is not there.
NEEDS = {
    "motion": "it moves the device: allow it with --allow motion",
    "destructive": "it resets the device or spoils its set-up: allow it with --allow destructive",
    "line faults": "nothing can be put between this driver and this endpoint",
    "checked replies": "the protocol of this driver has no checksums that we know of",
    "polaris bytes": "the device does not speak the NDI Polaris protocol, or the driver does not say so",
    "tool definition": "no tool definition is configured",
    "serial line": "the endpoint is no serial line: rates and breaks have no meaning there",
    "live faults": "no control port is known by which the device could be made to fail: --control names one",
    "host time": "the theatre's time is not the host's",
}


class Outcome(StrEnum):
    """How a case ended."""

    PASS = "PASS"
    FAIL = "FAIL"
    SKIP = "SKIP"


class NotShown(Exception):
    """Raised by a case that cannot be decided here, such as when no stray is in sight. Its text says why."""


class Nonconformity(AssertionError):
    """Raised by a case when the device behaves otherwise."""


@dataclass(frozen=True)
class Case:
    """One behaviour under a stable number.

    T.. any tracker must show; P.. and D.. are lines of the Polaris checklist, about the unit and its driver.
    """

    number: str
    statement: str
    needs: frozenset[str]
    run: Callable[[DeviceUnderTest], None]


@dataclass
class Suite:
    """All cases of one kind of device, and how its simulator is started.

    `driver` is the driver that `--sim` and `--endpoint` mean unless another is named; `simulator` holds the
    arguments of `ronna-sim`; `motions` says what the cases move that need "motion".
    """

    kind: str
    driver: str
    simulator: tuple[str, ...]
    cases: list[Case] = field(default_factory=list)
    motions: str = ""

    def moving(self) -> list[str]:
        """Numbers of the cases that move the device."""
        return [case.number for case in self.cases if "motion" in case.needs]

    def only(self, beginnings: Sequence[str]) -> Suite:
        """The same suite with the cases whose number begins so; all of them when nothing is named.

        Raises CNF-003 when no case is left.
        """
        if not beginnings:
            return self
        cases = [case for case in self.cases if case.number.startswith(tuple(beginnings))]
        if not cases:
            raise NoSuchCase(f"no case of the {self.kind} suite begins with {' or '.join(beginnings)}")
        return replace(self, cases=cases)

    def case(
        self, number: str, statement: str, *, needs: tuple[str, ...] = ()
    ) -> Callable[[Callable[[DeviceUnderTest], None]], Callable[[DeviceUnderTest], None]]:
        """Add the decorated function as a case; numbers must be unique and needs known."""
        if unknown := set(needs) - set(NEEDS):
            raise ValueError(f"case {number} needs the unknown {', '.join(sorted(unknown))}")
        if any(other.number == number for other in self.cases):
            raise ValueError(f"two cases have the number {number}")

        def add(run: Callable[[DeviceUnderTest], None]) -> Callable[[DeviceUnderTest], None]:
            self.cases.append(Case(number, statement, frozenset(needs), run))
            return run

        return add


def check(condition: bool, expected: str, found: object = "") -> None:
    """Raise Nonconformity unless `condition`: what was expected, and what was found instead."""
    if not condition:
        raise Nonconformity(f"expected {expected}" + (f", found {found}" if found != "" else ""))


def refused(call: Callable[[], object], kind: type[Exception], what: str) -> Exception:
    """The error of that kind that `call` raises; Nonconformity when it raises none, or another."""
    try:
        call()
    except kind as error:
        return error
    except Exception as error:
        raise Nonconformity(f"expected {what} to raise {kind.__name__}, found {error!r}") from error
    raise Nonconformity(f"expected {what} to raise {kind.__name__}, found that it was carried out")
