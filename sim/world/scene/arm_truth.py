"""The true arm: parameter set S, which reproduces magnitudes measured on a real robot.

Set S, one standard deviation each: link translations 0.40 mm and rotations 0.05 deg per axis, joint
offsets 0.05 deg, harmonics 0.015 and 0.008 deg, backlash 0.02 deg, sag 0.03 deg, repeatability 0.015 mm
per axis. The 2 mm tool error of the set belongs to the mount.
"""

from __future__ import annotations

from math import radians
from typing import Any

import numpy as np

from sim.world.scene.model import ArmTruth, LinkError

LINK_TRANSLATION_MM = 0.40
LINK_ROTATION_RAD = radians(0.05)
JOINT_OFFSET_RAD = radians(0.05)
HARMONIC_1_RAD = radians(0.015)
HARMONIC_2_RAD = radians(0.008)
BACKLASH_RAD = radians(0.02)
SAG_RAD = radians(0.03)
REPEATABILITY_MM = 0.015
# Flange down, stereo head reaching forward: above the head, clear of every singularity.
HOME_DEG = (0.0, -75.0, 99.0, 0.0, 66.0, 180.0)


def draw_arm(generator: np.random.Generator) -> ArmTruth:
    """Draw a true arm of parameter set S."""

    def six(scale: float) -> Any:
        return tuple(float(value) for value in generator.normal(0.0, scale, 6))

    def three(scale: float) -> Any:
        return tuple(float(value) for value in generator.normal(0.0, scale, 3))

    def phases() -> Any:
        return tuple(float(value) for value in generator.uniform(0.0, 2 * np.pi, 6))

    links: Any = tuple(
        LinkError(translation_mm=three(LINK_TRANSLATION_MM), rotation_rad=three(LINK_ROTATION_RAD))
        for _ in range(6)
    )
    return ArmTruth(
        home_deg=HOME_DEG,
        links=links,
        joint_offset_rad=six(JOINT_OFFSET_RAD),
        harmonic_1_rad=six(HARMONIC_1_RAD),
        harmonic_1_phase_rad=phases(),
        harmonic_2_rad=six(HARMONIC_2_RAD),
        harmonic_2_phase_rad=phases(),
        sag_rad=(SAG_RAD, SAG_RAD),
        backlash_rad=(BACKLASH_RAD,) * 6,
        repeatability_mm=REPEATABILITY_MM,
    )
