"""Interlocks and operator controls: emergency stop, guard, key switch, enabling switch, start key."""

from __future__ import annotations

from dataclasses import dataclass

from ronna_hw.wire.kuka_eki import OperationMode

MANUAL_MODES = (OperationMode.T1, OperationMode.T2)


@dataclass
class Interlocks:
    """State of the interlocks. In T1 and T2 an operator is present and holds the enabling switch."""

    mode: OperationMode = OperationMode.EXT
    emergency_stop: bool = False
    guard_open: bool = False
    enabling_switch: bool = True  # only relevant in T1 and T2
    start_key: bool = False  # the same; a program runs while it is held

    @property
    def manual(self) -> bool:
        """True in the test modes."""
        return self.mode in MANUAL_MODES

    @property
    def guard_matters(self) -> bool:
        """Whether an open guard forbids motion; in the test modes people work inside it."""
        return self.guard_open and not self.manual

    @property
    def forbids_drives(self) -> bool:
        """Whether the drives cannot be switched on."""
        return self.emergency_stop or self.guard_matters or (self.manual and not self.enabling_switch)

    @property
    def forbids_program(self) -> str:
        """Why no program may run in this mode now; empty when one may."""
        if self.mode is OperationMode.AUT:
            return "mode AUT: the program can only be started at the pendant"
        if self.manual and not self.start_key:
            return f"mode {self.mode}: the start key is not held"
        return ""
