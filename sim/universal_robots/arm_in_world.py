"""The arm in the world: publishes its true flange, errors of gears and links included.

The controller knows its encoders and the chain that the factory measured, never this.
"""

from __future__ import annotations

from collections.abc import Callable
from math import exp, radians
from typing import Final

from sim.errors import BAD_SCENE
from sim.universal_robots.controller_parameters import ControllerParameters
from sim.universal_robots.drives import Drives
from sim.universal_robots.model import Model
from sim.world.gears import Gears
from sim.world.scene.model import ArmTruth
from sim.world.true_arm import TrueArm
from sim.world.world import ArmState

FLANK_TIME_S: Final = 0.015  # in which a joint changes to its other flank, as an arm of this size does (U)


class ArmInWorld(Gears):
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
        super().__init__(drives.actual, radians(parameters.reversal_deg), last)
        self._true = TrueArm(truth, seed)
        self._publish = publish
        self._drives = drives
        self._cycle_s = cycle_s
        self._flank_share = 1.0 - exp(-cycle_s / FLANK_TIME_S)
        self._motion_step_rad = radians(parameters.motion_speed_deg_s) * cycle_s
        self._angles = drives.actual
        self._rests = False  # and that is published
        self.follow()

    def follow(self) -> None:
        """Publish what the last cycle has changed."""
        drives, angles = self._drives, self._drives.actual
        if self._rests and drives.at_rest and angles is self._angles:
            return
        if angles is not self._angles:
            self._turn(angles, self._angles, self._motion_step_rad)
            self._angles = angles
        self._rests = drives.at_rest
        if self._rests:
            self._in_motion = False
            self.flanks = list(self._directions)
        else:
            self.moved_s += self._cycle_s
            self._approach_flanks(self._flank_share)
        self._publish(self.state(self._true, angles, at_rest=self._rests))


def require_arm(truth: ArmTruth, model: Model) -> None:
    """Raise SIM-001 if the scene has another arm than the controller moves."""
    if truth.variant != model.name:
        raise BAD_SCENE(
            f"a controller of a {model.name} does not move the scene's arm {truth.variant}",
            action=f"Choose --model {truth.variant}, or a scene with this arm.",
        )
