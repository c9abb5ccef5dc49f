"""Conditions that a device must meet before a case can begin, as reported by the device."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from ronna_hw.devices.probing import Diagnostic

MESSAGES = "messages"  # the name of the fact that a person fulfils by acknowledging messages


@dataclass(frozen=True)
class Fact:
    """One condition: name, such as `operating mode`, finding, whether a case can begin, else what to do."""

    name: str
    found: str
    ready: bool = True
    advice: str = ""


def counted_fact(name: str, count: int) -> tuple[Fact, ...]:
    """What a driver counted, as it tells it unsolicited; nothing while there was none."""
    return (Fact(name, str(count)),) if count else ()


@runtime_checkable
class TellsReadiness(Protocol):
    """A device that can report more about its readiness than that it answers."""

    def readiness(self, timeout_s: float = 1.0) -> Sequence[Fact]:
        """Everything that decides whether it can be activated, read now. Allowed from CONNECTED.

        Moves nothing and changes nothing. Raises the errors of reading from the device.
        """
        ...


def fact_diagnostics(subject: str, device: TellsReadiness) -> Iterator[Diagnostic]:
    """Each fact as a line of the doctor, with its advice if a case cannot begin."""
    for fact in device.readiness():
        yield Diagnostic(f"{subject}{fact.name}", fact.ready, fact.found, "" if fact.ready else fact.advice)
