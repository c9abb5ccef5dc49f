"""Sums of the load signals at rest: kept cycle by cycle, so that means need no reader in step with them."""

from __future__ import annotations

from operator import add
from typing import NamedTuple

from ronna_hw.arm_stream.records import LOAD_SIGNALS, LinkState
from ronna_hw.vectors import JointVector, Vector3, joint_vector

Signals = tuple[float, ...]  # currents, expected currents, force on the tool
NO_SIGNALS: Signals = (0.0,) * LOAD_SIGNALS


class LoadMeans(NamedTuple):
    """Means over cycles at rest, in the controller's own units."""

    cycles: int
    currents: JointVector
    expected_currents: JointVector
    force: Vector3


class LoadSums:
    """Sums over the cycles of the present standstill."""

    def __init__(self) -> None:
        self.cycles = 0
        self.since = 0  # number of the cycle with which they begin
        self.sums: Signals = NO_SIGNALS

    def clear(self) -> None:
        """Forget the standstill: the arm moves."""
        self.cycles, self.sums = 0, NO_SIGNALS

    def note(self, signals: Signals, cycle: int) -> None:
        """Add the signals of a cycle."""
        if not self.cycles:
            self.since = cycle
        self.cycles += 1
        self.sums = tuple(map(add, self.sums, signals))


def mean_loads(before: LinkState, after: LinkState) -> LoadMeans:
    """Return the means over the cycles between two states of one standstill."""
    cycles = after.load_cycles - before.load_cycles
    means = [(b - a) / cycles for a, b in zip(before.load_sums, after.load_sums, strict=True)]
    x, y, z = means[12:]
    return LoadMeans(cycles, joint_vector(means[:6]), joint_vector(means[6:12]), (x, y, z))
