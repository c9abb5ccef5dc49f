"""Prediction of the target error during planning, and selection of the strategy that minimizes it.

The case predicts from its measurements of the spheres; here only the markers in the CT are known and, with an
arm, the poses found by a path check. The stereo measurement itself is not known yet.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from procedures.calibration.arm_sources import ArmPoses, arm_sources, ct_errors
from procedures.imaging.markers import ScanDeformation
from procedures.imaging.scan_deformation import open_strains
from procedures.planning.free_angle import choose_free_angles
from procedures.planning.guide import (
    direction_covariance_mm2,
    instrument_covariance_mm2,
)
from procedures.planning.learning_looks import look_sides
from procedures.planning.line_of_sight import StereoSight
from procedures.planning.plan_model import Plan, PlannedTrajectory
from procedures.planning.pose_name import PoseKind, PoseName
from procedures.planning.visits import ArmSetting, PathCheck, Reached
from procedures.registration.arm_adjustment import predict_before_looks
from procedures.registration.arm_hypotheses import share_by_sphere
from procedures.registration.error_sources import (
    DIRECTION,
    FUSION,
    INSTRUMENT,
    OF_SPHERES,
    REPEATABILITY,
    SCAN,
    SEATING,
)
from procedures.registration.points import FEWEST_PAIRS
from procedures.registration.target_prediction import (
    IndependentErrors,
    SharedErrors,
    TargetPrediction,
    predict_target_error,
)
from procedures.strategies.catalogue import CANDIDATES, BestOfEach
from procedures.strategies.skin_looks import SKIN
from procedures.strategies.strategy import rest_sides
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arrays import Array

if TYPE_CHECKING:
    from procedures.planning.theatre_arm import TheatreArm

USUAL_SEATING_MM = 0.05  # per axis, the default of a theatre file


def predict_by_markers(
    markers_mm: Array,
    covariances_mm2: Array,
    target_mm: Sequence[float],
    deformation: ScanDeformation | None = None,
    fusion_error_mm: float | None = None,
) -> TargetPrediction:
    """Predict the target error from the errors of a CT, the seating of its markers, and a fusion if any.

    Markers are (n, 3) mm, covariances (n, 3, 3). `deformation` is what they show of the scan as a whole.
    """
    sources: tuple[SharedErrors | IndependentErrors, ...] = (
        ct_errors(covariances_mm2),
        scan_errors(deformation, markers_mm, target_mm, np.eye(3)),
        _seating_errors(len(markers_mm), USUAL_SEATING_MM),
        *fusion_errors(fusion_error_mm, len(markers_mm)),
    )
    return predict_target_error(markers_mm, target_mm, sources)


def scan_errors(
    measured: ScanDeformation | None, spheres_mm: Array, target_mm: ArrayLike, rotation: Array
) -> SharedErrors:
    """Return the errors of a CT stretched or sheared as a whole, within what its spheres leave open.

    What the spheres (n, 3) mm have in common of it cancels in the registration; the rest grows with the
    distance of the target (3,) mm from them. Both are in the CT; `rotation` (3, 3) is robot <- CT.
    """
    offsets = np.vstack([spheres_mm, target_mm]) - spheres_mm.mean(axis=0)
    displaced = np.einsum("ij,kjl,nl->nik", rotation, open_strains(measured), offsets)
    return SharedErrors(SCAN, displaced[:-1], displaced[-1])


def predict_with_arm(
    theatre: TheatreArm,
    plan: Plan,
    covariances_mm2: Array,
    check: PathCheck,
    identifier: str,
    deformation: ScanDeformation | None = None,
) -> TargetPrediction:
    """Predict the target error with arm, tool frame, calibrations and instrument, from a passed check.

    The CT's errors are as in `predict_by_markers`.
    """
    planned = plan.trajectory(identifier)
    setting = theatre.arm
    sphere_visits, target = select_poses(setting, check, identifier)
    rotation = setting.robot_from_ct.rotation_matrix
    fiducials = [one.visit.name.fiducial for one in sphere_visits if one.visit.name.fiducial is not None]
    tip_mm = np.asarray(setting.robot_from_ct.apply(planned.target_mm), dtype=float)
    spheres = np.array([one.visit.pose.translation_mm for one in sphere_visits])
    spheres_ct_mm = np.asarray(setting.robot_from_ct.inverse().apply(spheres))
    zero = np.zeros((len(sphere_visits), 3, 3))
    sources = [
        ct_errors(rotation @ covariances_mm2[fiducials] @ rotation.T),
        scan_errors(deformation, spheres_ct_mm, planned.target_mm, rotation),
        _seating_errors(len(sphere_visits), theatre.seating_error_mm),
        *fusion_errors(planned.fusion_error_mm, len(sphere_visits)),
        *arm_error_sources(setting, check, identifier, tip_mm),
        *_guide_errors(theatre, plan, planned, target, zero),
        *(IndependentErrors(name, zero, np.eye(3) * rms**2 / 3.0) for name, rms in theatre.at_target_mm),
    ]
    if not setting.strategy.learns_arm:
        return predict_target_error(spheres, tip_mm, sources)
    shared = [
        share_by_sphere(one, fiducials)
        if isinstance(one, IndependentErrors) and one.source in OF_SPHERES
        else one
        for one in sources
    ]
    arm = {one.source for one in arm_error_sources(setting, check, identifier, tip_mm)} - {REPEATABILITY}
    return predict_before_looks(
        spheres,
        tip_mm,
        [one for one in shared if one.source in arm],
        [one for one in shared if one.source not in arm],
    )


def select_poses(setting: ArmSetting, check: PathCheck, identifier: str) -> tuple[list[Reached], Reached]:
    """Select a target and its localizations from a passed check."""
    target = check.at(PoseName(PoseKind.TARGET, identifier))
    all_localizations = [
        one
        for one in check.reached
        if one.visit.name.kind is PoseKind.FIDUCIAL and one.visit.name.trajectory != SKIN
    ]
    own = [one for one in all_localizations if one.visit.name.trajectory == identifier]
    return own if setting.strategy.localizes_per_trajectory else all_localizations, target


def arm_error_sources(
    setting: ArmSetting, check: PathCheck, identifier: str, tip_mm: Array
) -> tuple[SharedErrors | IndependentErrors, ...]:
    """Return the arm and tool frame errors between localizations and a tip (3,) mm, robot frame.

    If a strategy does not control the approach, the side of backlash on which a joint rests is unknown.
    """
    sphere_visits, target = select_poses(setting, check, identifier)
    target_pose = (setting.kinematics, target.visit.pose, target.at_rad, setting.flange_from_tool)
    at_spheres = None
    if setting.strategy.controls_approach:
        names = [one.visit.name.trajectory for one in sphere_visits]
        at_spheres = np.array(look_sides(setting, check.targets, names), dtype=float)
    at_target = np.array([rest_sides(*target_pose, target.visit.approach_mm)], dtype=float)
    return arm_sources(
        setting.kinematics.chain,
        ArmPoses(
            np.array([one.at_rad for one in sphere_visits]),
            np.array([one.visit.pose.translation_mm for one in sphere_visits]),
            at_spheres,
        ),
        ArmPoses(np.array([target.at_rad]), tip_mm[None], at_target),
        setting.sizes,
        servo_mm=0.0,  # the servo's residual is measured
    )


def fusion_errors(error_mm: float | None, spheres: int) -> tuple[IndependentErrors, ...]:
    """Return the error at a target chosen in another series, rms in mm; none for one chosen in the CT."""
    if error_mm is None:
        return ()
    return (IndependentErrors(FUSION, np.zeros((spheres, 3, 3)), np.eye(3) * error_mm**2 / 3.0),)


def _seating_errors(markers: int, per_axis_mm: float) -> IndependentErrors:
    return IndependentErrors(SEATING, np.tile(np.eye(3) * per_axis_mm**2, (markers, 1, 1)), np.zeros((3, 3)))


def _guide_errors(
    theatre: TheatreArm, plan: Plan, planned: PlannedTrajectory, target: Reached, zero: Array
) -> Iterable[IndependentErrors]:
    held = target.visit.pose.rotation_matrix
    yield IndependentErrors(INSTRUMENT, zero, instrument_covariance_mm2(plan, planned, theatre.bore, held))
    turned = direction_covariance_mm2(plan, planned, theatre.bore, theatre.guide_direction_rad, held)
    yield IndependentErrors(DIRECTION, zero, turned)


def choose_best_strategies(
    setting: ArmSetting, trajectories: Sequence[Trajectory], fiducials_mm: ArrayLike, sight: StereoSight
) -> ArmSetting:
    """Resolve the strategy `best` for each trajectory; other strategies are unchanged.

    Trajectories and fiducials (n, 3) are in CT mm. Candidates must be visible, reachable and clear.
    """
    if not isinstance(setting.strategy, BestOfEach):
        return setting
    chosen = {}
    for one in trajectories:
        predicted_mm = {}
        for candidate in CANDIDATES:
            alone = replace(setting, strategy=candidate, skin_looks=())
            turned = choose_free_angles(alone, (one,), fiducials_mm, sight)
            if turned.check.passed:
                predicted_mm[candidate] = predict_arm_error_mm(alone, turned.check, one)
        if predicted_mm:
            chosen[one.identifier] = min(predicted_mm, key=lambda name: predicted_mm[name])
    return replace(setting, strategy=replace(setting.strategy, others=chosen))


def predict_arm_error_mm(setting: ArmSetting, check: PathCheck, trajectory: Trajectory) -> float:
    """Predict the rms arm error at a target in mm, from a check of its trajectory alone.

    Evaluated at the instrument's tip, wherever on the axis the guide is held. Errors of CT and stereo head do
    not depend on the orientation.
    """
    sphere_visits, _ = select_poses(setting, check, trajectory.identifier)
    spheres = np.array([one.visit.pose.translation_mm for one in sphere_visits])
    tip = np.asarray(setting.robot_from_ct.apply(trajectory.target_mm))
    sources = arm_error_sources(setting, check, trajectory.identifier, tip)
    if len(spheres) < FEWEST_PAIRS:
        return _rms_of_shift(sources)
    return predict_target_error(spheres, tip, sources).rms_mm


def _rms_of_shift(sources: Iterable[SharedErrors | IndependentErrors]) -> float:
    """Return the rms arm error at a target where few spheres give the place, and the skin the orientation."""
    square_mm2 = 0.0
    for one in sources:
        if isinstance(one, SharedErrors):
            square_mm2 += float(np.sum((one.at_target_mm - one.at_spheres_mm.mean(axis=0)) ** 2))
        else:
            of_mean = one.at_spheres_mm2.sum(axis=0) / len(one.at_spheres_mm2) ** 2
            square_mm2 += float(np.trace(one.at_target_mm2 + of_mean))
    return math.sqrt(square_mm2)
