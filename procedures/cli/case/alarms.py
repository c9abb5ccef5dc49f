"""What a person at an open question learns of the devices: an answer may rely on an arm that moves."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from procedures.engine.engine import Engine

LOOK_AGAIN_S = 0.2  # host time between two looks while nothing is typed
MEANS = "Whatever you answer, no motion and no step begins before the fault is acknowledged by name."


class Alarms:
    """The devices in fault, as they were last seen: asks none of them anything."""

    def __init__(self) -> None:
        self._engine: Engine | None = None
        self._reported: set[str] = set()  # roles, at this question

    def attach(self, engine: Engine) -> None:
        """From now on the devices of this engine are looked at; before, none."""
        self._engine = engine

    def begin(self) -> None:
        """A question opens: what is in fault already is shown with it."""
        self._reported = set()

    def new(self) -> list[str]:
        """One line for each device in fault of which this question's reader does not know yet."""
        faults = self._faults()
        lines = [f"{what}. {MEANS}" for role, what in faults.items() if role not in self._reported]
        self._reported = set(faults)  # one that comes again is shown again
        return lines

    @property
    def note(self) -> str:
        """For the prompt, such as ` (the arm is in fault)`; empty while no device is."""
        roles = " and ".join(f"the {role}" for role in sorted(self._reported))
        return f" ({roles} {'is' if len(self._reported) == 1 else 'are'} in fault)" if roles else ""

    def _faults(self) -> dict[str, str]:
        return {} if self._engine is None else self._engine.faults.in_short
