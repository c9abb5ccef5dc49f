"""The arm in the world: publishes its true flange, errors of gears and links included.

The controller knows its encoders and the chain that the factory measured, never this.
"""

from __future__ import annotations

from collections.abc import Callable
from math import copysign, exp, radians
from typing import Final

from sim.errors import BAD_SCENE
from sim.universal_robots.controller_parameters import ControllerParameters
from sim.universal_robots.drives import Drives
from sim.universal_robots.model import JOINTS, Model, Vector6
from sim.world.scene.model import ArmTruth
from sim.world.true_arm import TrueArm
from sim.world.world import ArmState

FLANK_TIME_S: Final = 0.015  # in which a joint changes to its other flank, as an arm of this size does (U)


class ArmInWorld:
    """Follows the drives of a controller and publishes where the flange truly is."""

    def __init__(
        self,
        truth: ArmTruth,
        seed: int,
        publish: Callable[[ArmState], None],
        drives: Drives,
        parameters: ControllerParameters,
        cycle_s: float,
        last: ArmState | None = None,
    ) -> None:
        """Begin with the gears of `last`, the arm's last state in a continued world."""
        self._true = TrueArm(truth, seed)
        self._publish = publish
        self._drives = drives
        self._cycle_s = cycle_s
        self._flank_share = 1.0 - exp(-cycle_s / FLANK_TIME_S)
        self._reversal_rad = radians(parameters.reversal_deg)
        self._motion_step_rad = radians(parameters.motion_speed_deg_s) * cycle_s
        self._angles, self._extremes = drives.actual, list(drives.actual)
        self._flanks = [0.0] * JOINTS
        self._motion_number, self._moved_s = 0, 0.0
        if last is not None:
            self._flanks = [copysign(1.0, flank) if flank else 0.0 for flank in last.flanks]
            self._motion_number, self._moved_s = last.motion_number, last.moved_s
        self._directions = list(self._flanks)
        self._in_motion = False
        self._rests = False  # and that is published
        self.follow()

    def follow(self) -> None:
        """Publish what the last cycle has changed."""
        drives, angles = self._drives, self._drives.actual
        if self._rests and drives.at_rest and angles is self._angles:
            return
        if angles is not self._angles:
            self._turn(angles)
        self._rests = drives.at_rest
        if self._rests:
            self._in_motion = False
            self._flanks = list(self._directions)
            pose = self._true.at_rest(angles, self._flanks, self._motion_number, self._moved_s)
        else:
            self._moved_s += self._cycle_s
            share = self._flank_share
            self._flanks = [
                flank + share * (direction - flank)
                for flank, direction in zip(self._flanks, self._directions, strict=True)
            ]
            pose = self._true.moving(angles, self._flanks, self._moved_s)
        joints, flanks = _six(angles), _six(self._flanks)
        self._publish(ArmState(joints, pose, self._motion_number, self._rests, flanks, self._moved_s))

    def _turn(self, angles_rad: list[float]) -> None:
        """Take new angles: a motion begins, a joint changes its flank once it has turned back far enough."""
        fastest = 0.0
        extremes, directions = self._extremes, self._directions
        for joint, (angle, before) in enumerate(zip(angles_rad, self._angles, strict=True)):
            step = angle - before if angle > before else before - angle
            if step > fastest:
                fastest = step
            travelled = angle - extremes[joint]
            if directions[joint] * travelled > 0.0:
                extremes[joint] = angle
            elif travelled > self._reversal_rad or travelled < -self._reversal_rad:
                directions[joint] = 1.0 if travelled > 0.0 else -1.0
                extremes[joint] = angle
        moves = fastest > self._motion_step_rad
        if moves and not self._in_motion:
            self._motion_number += 1
        self._in_motion, self._angles = moves, angles_rad


def require_arm(truth: ArmTruth, model: Model) -> None:
    """Raise SIM-001 if the scene has another arm than the controller moves."""
    if truth.variant != model.name:
        raise BAD_SCENE(
            f"a controller of a {model.name} does not move the scene's arm {truth.variant}",
            action=f"Choose --model {truth.variant}, or a scene with this arm.",
        )


def _six(values: list[float]) -> Vector6:
    one, two, three, four, five, six = values
    return one, two, three, four, five, six
