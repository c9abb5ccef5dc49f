"""Gears of an arm: the flank on which each joint rests in its backlash, and the count of its motions."""

from __future__ import annotations

from collections.abc import Sequence
from math import copysign

from sim.world.nominal_arm import AXES
from sim.world.true_arm import TrueArm
from sim.world.world import ArmState


class Gears:
    """Flanks and motions as the encoders turn, with angles in the unit of the simulator."""

    def __init__(self, angles: Sequence[float], reversal: float, last: ArmState | None = None) -> None:
        """Begin on the flanks of `last`, the arm's last state in a continued world."""
        self.flanks: list[float] = [0.0] * AXES  # position of each joint in its backlash, -1 to 1
        self.motion_number = 0
        self.moved_s = 0.0  # time in motion so far
        if last is not None:
            self.flanks = [copysign(1.0, flank) if flank else 0.0 for flank in last.flanks]
            self.motion_number, self.moved_s = last.motion_number, last.moved_s
        self._reversal = reversal  # after which a joint rests on its other flank
        self._extremes = list(angles)
        self._directions = list(self.flanks)
        self._in_motion = False

    def state(self, arm: TrueArm, joints_rad: Sequence[float], *, at_rest: bool) -> ArmState:
        """Return the state of an arm with these gears, its flange as it truly is."""
        if at_rest:
            pose = arm.at_rest(joints_rad, self.flanks, self.motion_number, self.moved_s)
        else:
            pose = arm.moving(joints_rad, self.flanks, self.moved_s)
        return ArmState(
            tuple(joints_rad), pose, self.motion_number, at_rest, tuple(self.flanks), self.moved_s
        )

    def _turn(self, angles: Sequence[float], before: Sequence[float], motion_step: float) -> None:
        """Take new angles: a motion begins, a joint changes its flank once it has turned back far enough."""
        reversal, fastest = self._reversal, 0.0
        extremes, directions = self._extremes, self._directions
        for joint, (new, old) in enumerate(zip(angles, before, strict=True)):
            step = new - old if new > old else old - new
            if step > fastest:
                fastest = step
            travelled = new - extremes[joint]
            if directions[joint] * travelled > 0.0:
                extremes[joint] = new
            elif travelled > reversal or travelled < -reversal:
                directions[joint] = 1.0 if travelled > 0.0 else -1.0
                extremes[joint] = new
        moves = fastest > motion_step
        if moves and not self._in_motion:
            self.motion_number += 1
        self._in_motion = moves

    def _approach_flanks(self, share: float) -> None:
        self.flanks = [
            flank + share * (direction - flank)
            for flank, direction in zip(self.flanks, self._directions, strict=True)
        ]
