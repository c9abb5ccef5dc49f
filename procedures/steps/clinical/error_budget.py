"""Error budget of a registration: residual gate, arm, tool frame, held guide, tables for the operator.

The arm's own errors are propagated joint by joint between spheres and target, so that what they share
cancels. They are those of the arm's record, limited to those of an uncalibrated arm in proportion. If a
strategy does not control the approach, the servo leaves each joint on an unknown side of its backlash. The
residual of the servo itself is measured.

The guide turns with the head except about its own axis. After a followed move the arm holds it with other
joints, and some errors common to spheres and target remain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from procedures.calibration.arm_sources import ArmPoses, arm_sources, identified_errors
from procedures.engine.context import StepContext
from procedures.operator.question import Evidence
from procedures.planning.guide import place_guide
from procedures.planning.plan_model import PlannedTrajectory
from procedures.registration import TwoWayTable, register, target_prediction
from procedures.registration.error_theory import FreGate
from procedures.registration.errors import CollinearPoints
from procedures.registration.point_registration import Registration
from procedures.registration.points import FEWEST_PAIRS
from procedures.registration.target_prediction import AllowedErrors, SharedErrors
from procedures.steps.clinical.path_check import CheckedPaths, LocalizationPose
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.relocalization import arriving
from procedures.steps.clinical.results import Prediction
from procedures.strategies.trajectory import refine_target_pose
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.error_budget import ErrorSizes, arm_error_mm, backlash_mm2
from ronna_hw.frames import Transform
from ronna_hw.text import format_count
from ronna_hw.vectors import JointVector

REPEATABILITY_MM = 0.03  # per axis: robot at rest, and the servo's tolerance
# The arm's error varies slowly with its joints: neighbouring points share it, distant ones do not, so they
# are not independent points of one sigma. Where a record has no covariance that says what they share, only
# the gate allows for this; prediction and weights of the fit keep the stated sigma. The price: with 4 spheres
# and a sigma of 0.1 mm, a moved sphere is found (9 times of 10) from 1.2 mm instead of 1.0; with twice the
# sigma from 1.8.
# Safety against spheres of CT and robot that do not agree. Source: simulated cases.
GATE_ARM_RESERVE = 1.5

ALIKE_MM = 1e-6  # shared displacements that differ by less are one
# Safety against spheres of CT and robot that do not agree (U).
GATE_CONFIDENCE = 0.999  # of the chi-square gate: one false alarm in a thousand registrations

GROSS_MM = 3.0  # a sphere on its screw that is off by more is seen by eye (unconfirmed)
NOTHING = "-"


def allow_for_stated_arm(measured_mm2: Array, arm_mm: float, shared_mm: Array) -> AllowedErrors:
    """Allow for an arm known by its sigma per axis alone, with a reserve.

    `measured_mm2` (n, 3, 3) is the covariance of CT, seating and stereo head; `shared_mm` (n, 3, k) is the
    displacement by one standard deviation of each error of the tool frame.
    """
    return AllowedErrors(measured_mm2 + arm_covariance_mm2(GATE_ARM_RESERVE * arm_mm), shared_mm)


def residual_gate(image_mm: Array, physical_mm: Array, allowed: AllowedErrors) -> FreGate:
    """Gate the residual of paired points (n, 3) mm. Raises REG-001 to REG-006."""
    fit = register(image_mm, physical_mm, covariance_mm2=allowed.independent_mm2)
    if float(np.ptp(allowed.shared_mm, axis=0).max()) < ALIKE_MM:  # the pose takes all of it
        return fit.gate(confidence=GATE_CONFIDENCE)
    mapped = np.asarray(fit.transform.apply(fit.image_mm), dtype=float)
    return target_prediction.gate_residuals(fit.residuals_mm, mapped, allowed, GATE_CONFIDENCE)


def find_moved_spheres(image_mm: Array, physical_mm: Array, allowed: AllowedErrors) -> tuple[int, ...]:
    """Return the pairs whose removal makes the gate pass, most likely first; see `residual_gate`."""
    found: list[tuple[float, int]] = []
    for index in range(len(image_mm) if len(image_mm) > FEWEST_PAIRS else 0):
        keep = np.arange(len(image_mm)) != index
        try:
            gate = residual_gate(image_mm[keep], physical_mm[keep], allowed[keep])
        except CollinearPoints:
            continue
        if gate.passed:
            found.append((gate.fre_mm, index))
    return tuple(index for _, index in sorted(found))


def find_undetected_sphere(
    fit: Registration, target_mm: Array, gate: FreGate, allowed: AllowedErrors
) -> target_prediction.UnnoticedPoint:
    """Find the sphere whose displacement could move the target furthest while still passing the `gate`.

    `fit` is the registration used, `target_mm` (3,) is in its physical frame.
    """
    return target_prediction.find_unnoticed_point(
        np.asarray(fit.transform.apply(fit.image_mm), dtype=float),
        target_mm,
        allowed,
        None if fit.covariance_mm2 is None else np.linalg.inv(fit.covariance_mm2),
        gate,
        GROSS_MM,
    )


def arm_covariance_mm2(arm_mm: float) -> Array:
    """Return the covariance (3, 3) mm2 of one point at rest, from the arm's sigma per axis."""
    return np.asarray(np.eye(3) * (arm_mm**2 + REPEATABILITY_MM**2))


@dataclass(frozen=True)
class HeldGuide:
    """Guide held at a target (rotation robot <- tool, joints, tip (3,) mm) after `head_rotation` (3, 3).

    The joints arrive from `sides` of their backlash.
    """

    rotation: Array
    joints_rad: JointVector
    tip_mm: Array
    head_rotation: Array
    sides: tuple[int, ...] | None

    def turn_with_head(self, source: target_prediction.SharedErrors) -> target_prediction.SharedErrors:
        """Rotate a source's errors at the target, which are the head's own, with the head."""
        return replace(source, at_target_mm=self.head_rotation @ source.at_target_mm)

    def turn_errors_back(
        self, source: target_prediction.SharedErrors | target_prediction.IndependentErrors
    ) -> target_prediction.SharedErrors | target_prediction.IndependentErrors:
        """Rotate a source's errors at the target back into the head's orientation at the localization."""
        back = self.head_rotation.T
        if isinstance(source, target_prediction.SharedErrors):
            return replace(source, at_target_mm=back @ source.at_target_mm)
        return replace(source, at_target_mm2=back @ source.at_target_mm2 @ back.T)

    def turn_correction(self, shift_mm: Array) -> Array:
        """Rotate a correction (3,) mm by errors turned back with the head, into the robot frame of now."""
        return np.asarray(self.head_rotation @ shift_mm)


def predict_held_guide(
    context: StepContext, planned: PlannedTrajectory, robot_from_ct: Transform, moved: Transform | None
) -> HeldGuide:
    """Predict the guide's pose at a target, following any head move. Raises ARM-001 to ARM-003."""
    path, tip_mm = context.result(CheckedPaths).targets[planned.id], robot_from_ct.apply(planned.target_mm)
    pose = path.tool_pose.transform
    if moved is None:
        return HeldGuide(pose.rotation_matrix, path.joints_rad, tip_mm, np.eye(3), path.sides)
    workcell = context.workcell
    along = place_guide(context.result(CheckedPlan).plan, planned, workcell.tools.guide.bore)
    pose = refine_target_pose(pose, along, moved @ robot_from_ct)
    joints_rad = workcell.master.joints_at(pose, path.joints_rad, path.sides)
    tip_mm = moved.apply(tip_mm)
    return HeldGuide(pose.rotation_matrix, joints_rad, tip_mm, moved.rotation_matrix, path.sides)


def arm_errors(
    context: StepContext, looks: Sequence[LocalizationPose], spheres_mm: Array, target: str, held: HeldGuide
) -> tuple[target_prediction.SharedErrors | target_prediction.IndependentErrors, ...]:
    """Return the arm's errors at planned looks at spheres (n, 3) mm, robot frame, and at a target."""
    sides = context.result(CheckedPaths).targets[target].sides
    at_target = ArmPoses(np.array([held.joints_rad]), held.tip_mm[None], np.array([sides], dtype=float))
    return _stated_errors(context, _poses_of(context, looks, spheres_mm), at_target)


def errors_at_looks(
    context: StepContext, looks: Sequence[LocalizationPose], spheres_mm: Array
) -> tuple[target_prediction.SharedErrors | target_prediction.IndependentErrors, ...]:
    """Return the arm's errors at planned looks at spheres (n, 3) mm, robot frame, whatever the target."""
    anywhere = _poses_of(context, looks[:1], spheres_mm[:1])
    return _stated_errors(context, _poses_of(context, looks, spheres_mm), anywhere)


def _poses_of(context: StepContext, looks: Sequence[LocalizationPose], spheres_mm: Array) -> ArmPoses:
    """Return the poses of looks, with the sides on which the joints arrive if all are known."""
    paths = context.result(CheckedPaths)
    signs = [arriving(context, paths, one) for one in looks]
    known = [one for one in signs if one is not None]
    sides = np.array(known, dtype=float) if len(known) == len(looks) else None
    return ArmPoses(np.array([one.joints_rad for one in looks]), spheres_mm, sides)


def _stated_errors(
    context: StepContext, at_spheres: ArmPoses, at_target: ArmPoses
) -> tuple[target_prediction.SharedErrors | target_prediction.IndependentErrors, ...]:
    chain = context.workcell.master.arm.kinematics.chain
    sizes = ErrorSizes.stated(context.setting.settings, context.workcell.calibrations.arm)
    return arm_sources(chain, at_spheres, at_target, sizes, servo_mm=0.0)


def unknown_sides_mm2(context: StepContext, looks: Sequence[LocalizationPose], spheres_mm: Array) -> Array:
    """Return the sphere covariances (n, 3, 3) mm2 due to a calibrated arm's backlash on unknown sides.

    The stated error of an uncalibrated arm includes it.
    """
    arm, paths = context.workcell.calibrations.arm, context.result(CheckedPaths)
    if arm is None or arriving(context, paths, looks[0]) is not None:
        return np.zeros((len(looks), 3, 3))
    sizes = ErrorSizes.stated(context.setting.settings, arm)
    chain = context.workcell.master.arm.kinematics.chain
    return backlash_mm2(chain, np.array([one.joints_rad for one in looks]), spheres_mm, sizes)


def allowed_errors(
    context: StepContext,
    looks: Sequence[LocalizationPose],
    spheres_mm: Array,
    measured_mm2: Array,
    scan: SharedErrors,
) -> AllowedErrors:
    """Return the errors at looks at the spheres (n, 3) mm, robot frame, that the residual gate allows for.

    For an identified arm they are those of the prediction, with all that spheres share: its record says
    what. Otherwise the reserve on the arm's sigma stands for them, the `scan` as a whole included.
    """
    arm = context.workcell.calibrations.arm
    sizes = ErrorSizes.stated(context.setting.settings, arm)
    if sizes.identified is None:
        arm_mm = arm_error_mm(context.setting.settings, arm)
        tool_mm = sizes.tool_mm * np.array([one.tool_pose.transform.rotation_matrix for one in looks])
        return allow_for_stated_arm(measured_mm2, arm_mm, tool_mm)
    signs = [arriving(context, context.result(CheckedPaths), one) for one in looks]
    joints_rad = np.array([one.joints_rad for one in looks])
    unknown = (0,) * joints_rad.shape[1]
    sides = np.array([unknown if one is None else one for one in signs], dtype=float)
    chain = context.workcell.master.arm.kinematics.chain
    arm_alone = identified_errors(chain, ArmPoses(joints_rad, spheres_mm, sides), sizes.identified)
    return AllowedErrors(
        measured_mm2 + arm_alone.independent_mm2,
        np.concatenate([arm_alone.shared_mm, scan.at_spheres_mm], axis=2),
        arm_alone.freedom,
    )


def budget_table(predicted: Prediction) -> Evidence:
    """Tabulate the shares of a predicted error, largest first, and what it does not include."""
    shares = sorted(predicted.budget, key=lambda share: -share.rms_mm)
    return Evidence(
        title=f"Predicted error at {predicted.target}",
        head=("source", "mm rms"),
        rows=(
            *((share.source, f"{share.rms_mm:.3f}") for share in shares),
            ("total", f"{predicted.rms_mm:.3f}"),
            (f"not included: {predicted.excluded}", NOTHING),
            *(((f"assumed: {predicted.assumed}", NOTHING),) if predicted.assumed else ()),
        ),
    )


def two_way_table(table: TwoWayTable) -> Evidence:
    """Tabulate every CT sphere against the measurements in the room, distances in mm."""
    return Evidence(
        title="CT to room and room to CT"
        + ("" if table.agrees_both_ways else ": the two directions do NOT agree")
        + "".join(f"; sphere {one + 1} is not confirmed" for one in table.unmatched_ct)
        + (
            f"; {format_count(len(table.unmatched_room), 'reading')} without a sphere"
            if table.unmatched_room
            else ""
        ),
        head=(
            "sphere",
            "CT estimates differ mm",
            "from tracker mm",
            "from stereo head mm",
            "when fitted without it mm",
            "partner is nearest",
        ),
        rows=tuple(
            (
                str(row.fiducial + 1),
                _mm(row.ct_disagreement_mm),
                _mm(row.tracker_residual_mm),
                _mm(row.stereo_residual_mm),
                _mm(row.leave_one_out_mm),
                {True: "yes", False: "NO", None: NOTHING}[row.partner_is_nearest],
            )
            for row in table.ct_to_room
        ),
    )


def _mm(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.3f}"
