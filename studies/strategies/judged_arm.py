"""Knowledge of an arm in a trial, by controller and prediction: error sources, gates, and the limit shown.

The gate is also tried as it would be without the covariance of the arm's record, and without its allowance
for errors of the scan, of which the trials have none.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from procedures.calibration.arm_sources import SERVO_MM
from procedures.guards.stability import GUIDE_NOTICEABLE_MM
from procedures.imaging.markers import ScanDeformation
from procedures.imaging.scan_deformation import FALSE_ALARMS, FIT, KERNEL
from procedures.imaging.sphere_centre.ball_model import TERMS
from procedures.planning.target_error import scan_errors
from procedures.registration.error_theory import chi_square_limit
from procedures.registration.rigid_fit import RigidFit
from procedures.registration.target_prediction import (
    AllowedErrors,
    IndependentErrors,
    SharedErrors,
    TargetPrediction,
    allow_for,
    check_residuals,
    gate_residuals,
    predict_target_error,
)
from procedures.steps.clinical.error_budget import GATE_CONFIDENCE, allow_for_stated_arm
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.error_budget import ErrorSizes
from studies.accuracy.postures import Postures
from studies.accuracy.scene import AXES, FINE_CT_MM, StudiedScene
from studies.strategies.identified import BelievedArm

# Rms at a target of what no look of a case would show, without a room to look at: as whole cases state it.
UNNOTICED_MM = {"head": 0.10, "cart and tracker": 0.20, "guide": GUIDE_NOTICEABLE_MM / math.sqrt(3.0)}
Sources = list[SharedErrors | IndependentErrors]
RESIDUAL = "PRO-007"
# Shares of trials that other gates would refuse.
WITHOUT_COVARIANCE, WITHOUT_SCAN = "gate without covariance", "gate without scan"
# Shapes of five spheres that show no strain, as precisely as those of a usual scan.
SHAPES = ScanDeformation.model_validate(
    {
        "spheres": 5,
        "strain": np.zeros((AXES, AXES)).tolist(),
        "covariance": ((FIT**2 + KERNEL**2) * np.eye(TERMS)).tolist(),
        "chi_square": 0.0,
        "limit": chi_square_limit(TERMS, 1.0 - FALSE_ALARMS),
    }
)


@dataclass(frozen=True)
class JudgedArm:
    """Arm as a controller and a prediction know it: its model, stated errors, and local error."""

    believed: BelievedArm
    sizes: ErrorSizes
    arm_mm: float  # of the residual gate
    listed: dict[tuple[int, int, int], Sources] = field(default_factory=dict)

    def sources(self, scene: StudiedScene, planned: Postures, target: int, count: int) -> Sources:
        """List the error sources at a target registered by the first `count` spheres."""
        key = (scene.number, id(planned), target)  # the postures live as long as the bench
        if key not in self.listed:
            everything = len(scene.phantom.spheres_mm)
            self.listed[key] = scene.error_sources(planned, target, everything, self.sizes, FINE_CT_MM)
        return [
            replace(one, at_spheres_mm=one.at_spheres_mm[:count])
            if isinstance(one, SharedErrors)
            else replace(one, at_spheres_mm2=one.at_spheres_mm2[:count])
            for one in self.listed[key]
        ]

    def allowed(
        self, scene: StudiedScene, planned: Postures, nth: int, count: int
    ) -> dict[str, AllowedErrors]:
        """Return what the gates allow for at the first `count` spheres, by the gate."""
        spheres = len(planned.localizations) // planned.sets
        measured = np.eye(AXES) * (FINE_CT_MM**2 + SERVO_MM**2) / AXES
        turned = planned.localizations.rotations[nth * spheres : nth * spheres + count]
        stated = allow_for_stated_arm(
            np.tile(measured, (count, 1, 1)), self.arm_mm, self.sizes.tool_mm * turned
        )
        if self.sizes.identified is None:
            return {RESIDUAL: stated}
        freedom, target = self.sizes.identified.freedom, nth if planned.sets > 1 else 0
        sources = self.sources(scene, planned, target, count)
        ct_mm, rotation = scene.phantom.spheres_mm[:count], scene.robot_from_ct.rotation_matrix
        scan = scan_errors(SHAPES, ct_mm, ct_mm.mean(axis=0), rotation)
        return {
            RESIDUAL: allow_for([*sources, scan], count, freedom),
            WITHOUT_SCAN: allow_for(sources, count, freedom),
            WITHOUT_COVARIANCE: stated,
        }


def refusing_gates(
    image: Array, recorded: Array, fit: RigidFit, nth: int, allowed: Mapping[str, AllowedErrors]
) -> set[str]:
    """Return the gates that refuse the residual of a set."""
    mapped = image @ fit.rotation[nth].T + fit.translation_mm[nth]
    return {
        name
        for name, one in allowed.items()
        if not gate_residuals(recorded - mapped, mapped, one, GATE_CONFIDENCE).passed
    }


def predict(
    scene: StudiedScene,
    planned: Postures,
    target: int,
    count: int,
    judged: JudgedArm,
    image: Array,
    recorded: Array,
    fit: RigidFit,
) -> TargetPrediction:
    """Predict the error at a target from the arm, the CT and unnoticed changes, with the residual's test."""
    nth = planned.set_of(target)
    spheres = scene.robot_from_ct.apply(scene.phantom.spheres_mm[:count])
    target_mm = scene.robot_from_ct.apply(scene.phantom.trajectories[target].target_mm)
    sources = judged.sources(scene, planned, target, count)
    mapped = image[:count] @ fit.rotation[nth].T + fit.translation_mm[nth]
    residual = check_residuals(recorded[:count] - mapped, mapped, sources)
    nothing = np.zeros((count, AXES, AXES))
    unnoticed = [
        IndependentErrors(name, nothing, np.eye(AXES) * rms_mm**2 / AXES, rare=True)
        for name, rms_mm in UNNOTICED_MM.items()
    ]
    return predict_target_error(spheres, target_mm, [*sources, *unnoticed], residual=residual)


def without_unnoticed(predicted: TargetPrediction) -> TargetPrediction:
    """Return the prediction without the shares for changes that nobody would notice."""
    seen = {name: part for name, part in predicted.by_source_mm2.items() if name not in UNNOTICED_MM}
    return TargetPrediction(seen, predicted.at_spheres, predicted.widening)
