"""What must be true of a device before a case can begin, as the device itself tells it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable


@dataclass(frozen=True)
class Fact:
    """One of them: `operating mode`, what was found, whether a case can begin so, and what to do if not."""

    name: str
    found: str
    ready: bool = True
    advice: str = ""


@runtime_checkable
class TellsReadiness(Protocol):
    """A device that knows more about its readiness than that it answers."""

    def readiness(self, timeout_s: float = 1.0) -> Sequence[Fact]:
        """Everything that decides whether it can be activated, read now. Allowed from CONNECTED.

        Moves nothing and changes nothing. Raises what reading from the device raises.
        """
        ...
