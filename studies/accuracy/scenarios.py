"""Arms and CTs better than parameter set S: what calibration and a finer CT would achieve.

The levels are those assumed for a calibrated arm; harmonics and sag are those of set S, and so is backlash
unless it is `known`. A strategy that does not control the approach never knows on which side a joint rests.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ronna_hw.arm.error_budget import UNCALIBRATED, ErrorSizes
from sim.world.scene.arm_truth import BACKLASH_RAD, JOINT_OFFSET_RAD, LINK_ROTATION_RAD, LINK_TRANSLATION_MM
from sim.world.scene.model import ArmResidual
from sim.world.scene.stereo_head import TOOL_ERROR_MM
from studies.accuracy.random_arms import RandomArms
from studies.accuracy.trials import CT_FLE_MM, Sizes

CALIBRATED = ArmResidual()
# Backlash as known after calibration: twice the error that `ronna-campaign strategies --identified` finds.
CALIBRATED_BACKLASH_RAD = float(np.radians(0.0015))
FINE_CT_MM = 0.05  # 3-D rms
ANY_APPROACH = "thesis-ocs"


@dataclass(frozen=True)
class Scenario:
    """What is calibrated, and the CT error (3-D rms)."""

    name: str
    tool: bool = False
    kinematics: bool = False
    known: bool = False  # the backlash, to CALIBRATED_BACKLASH_RAD
    ct_mm: float = CT_FLE_MM

    @property
    def sizes(self) -> Sizes:
        """The errors outside the arm."""
        return Sizes(ct_mm=self.ct_mm)

    def left(self, strategy: str) -> ErrorSizes:
        """The remaining errors of the arm."""
        return replace(
            UNCALIBRATED,
            tool_mm=CALIBRATED.tool_mm if self.tool else TOOL_ERROR_MM,
            links=CALIBRATED.angle_rad / LINK_ROTATION_RAD if self.kinematics else 1.0,
            backlash=self._backlash_left(strategy),
        )

    def _backlash_left(self, strategy: str) -> float:
        known = self.known and strategy != ANY_APPROACH
        return CALIBRATED_BACKLASH_RAD / BACKLASH_RAD if known else 1.0

    def of(self, arms: RandomArms, strategy: str) -> RandomArms:
        """The same arms, calibrated: their errors scaled down to what remains for a strategy."""
        arms = replace(arms, backlash_rad=arms.backlash_rad * self._backlash_left(strategy))
        if self.tool:
            arms = replace(arms, tool_error_mm=arms.tool_error_mm * CALIBRATED.tool_mm / TOOL_ERROR_MM)
        if not self.kinematics:
            return arms
        turns = Rotation.from_matrix(arms.link_rotation.reshape(-1, 3, 3)).as_rotvec()
        remaining = Rotation.from_rotvec(turns * CALIBRATED.angle_rad / LINK_ROTATION_RAD).as_matrix()
        return replace(
            arms,
            link_translation_mm=arms.link_translation_mm * CALIBRATED.link_mm / LINK_TRANSLATION_MM,
            link_rotation=remaining.reshape(arms.link_rotation.shape),
            joint_offset_rad=arms.joint_offset_rad * CALIBRATED.angle_rad / JOINT_OFFSET_RAD,
        )


SET_S = Scenario("set S")
SCENARIOS = (
    SET_S,
    Scenario("tool calibrated", tool=True),
    Scenario("tool and kinematics calibrated", tool=True, kinematics=True),
    Scenario("fine CT", ct_mm=FINE_CT_MM),
    Scenario("tool calibrated, fine CT", tool=True, ct_mm=FINE_CT_MM),
    Scenario("tool and kinematics calibrated, fine CT", tool=True, kinematics=True, ct_mm=FINE_CT_MM),
    Scenario("the same, backlash known too", tool=True, kinematics=True, known=True, ct_mm=FINE_CT_MM),
)
