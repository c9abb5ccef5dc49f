"""What each step of a clinical case would have left, from the truth of the scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from clinical_case import (
    CENTRES_CT_MM,
    FIRST,
    HOME_RAD,
    ROBOT_FROM_CT,
    SCENE,
    SIGMA_MM,
    SPHERES_MM,
    TRACKER_MM,
    TRAJECTORIES,
    ClinicalCell,
)
from localized_spheres import localized_marker
from recording_cell import GUIDE, RecordingCell

from procedures.engine.engine import Engine
from procedures.engine.order import StepSpec
from procedures.imaging.markers import ScanDeformation
from procedures.journal.results import FramedPose, StepResult
from procedures.planning.guide import place_guides
from procedures.planning.head_in_ct import HeadEllipsoid
from procedures.planning.plan_model import FiducialKind, PatientPosition, Plan, PlanFusion, PlannedTrajectory
from procedures.registration.correspondence import MatchStatus
from procedures.registration.verification import TwoWayTable
from procedures.steps.clinical import at_target, positioning, retreat
from procedures.steps.clinical.cart_lock import LockedCart
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.head_clamp import ClampedHead
from procedures.steps.clinical.path_check import CheckedPaths, LocalizationPose, TargetPose
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.results import (
    LearnedArm,
    LinkHealth,
    Prediction,
    RegisteredRobot,
    Relocalization,
)
from procedures.steps.clinical.set_up import CheckedSetUp, DeviceIdentity, DriverSettings
from procedures.steps.clinical.tool_change import MountedGuide
from procedures.steps.clinical.tool_check import CheckedTool
from procedures.strategies.strategy import ArmInBranch
from procedures.strategies.trajectory import Trajectory, back_along_axis, target_pose
from procedures.workcell import MountedTool
from ronna_hw.arrays import Array
from ronna_hw.config import ProcedureSettings
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.frames import Frame, Transform
from ronna_hw.roles import MASTER
from ronna_hw.vectors import JointVector

SERIES = "1.2.826.0.1.3680043.8.498.7"
APPROACH_MM = ProcedureSettings().approach_mm
ARRIVING = (1, -1, 1, -1, 1, -1)  # direction in which each joint arrives at a target
NO_TABLE = TwoWayTable(
    ct_to_room=(), room_to_ct=(), unmatched_ct=(), unmatched_room=(), agrees_both_ways=True
)
SIGMA_OF_SCAN = 3e-4  # of its strain, as five spheres show it
ZEROS: dict[str, Any] = {
    name: 0 for name in LinkHealth.model_fields if not name.endswith(("edges_us", "counts"))
}
LINK = LinkHealth(
    **ZEROS,
    histogram_edges_us=(),
    histogram_counts=(),
    jitter_counts=(),
)


def imported_ct() -> ImportedCt:
    return ImportedCt(
        series_instance_uid=SERIES,
        frame_of_reference_uid="1.2.3",
        patient_position="HFS",
        shape=(1, 1, 1),
        spacing_mm=(1.0, 1.0, 1.0),
        origin_mm=(0.0, 0.0, 0.0),
        axes=((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)),
        voxels_sha256="",
        warnings=(),
        study_instance_uid="1.2.4",
    )


def deformation(sigma: float) -> ScanDeformation:
    """Spheres that show no deformation, with this sigma."""
    none = (0.0, 0.0, 0.0)
    return ScanDeformation(
        spheres=4,
        strain=(none, none, none),
        covariance=(sigma**2 * np.eye(5)).tolist(),
        chi_square=0.0,
        limit=20.5,
    )


def localized_fiducials(centres_mm: Array = CENTRES_CT_MM) -> LocalizedFiducials:
    markers = tuple(
        localized_marker(centre, np.eye(3) * SIGMA_MM**2, agreement_mm=0.01) for centre in centres_mm
    )
    return LocalizedFiducials(
        series_instance_uid=SERIES,
        diameter_mm=11.5,
        markers=markers,
        doubtful=(),
        deformation=deformation(SIGMA_OF_SCAN),
    )


FUSED = PlanFusion(series_instance_uid="1.2.840.5", modality="MR", record_sha256="a" * 64)


def plan(**changes: object) -> Plan:
    """The plan of the scene; `changes` to each of its trajectories."""
    trajectories = [
        PlannedTrajectory(
            id=target.identifier,
            entry_mm=target.entry_ct_mm,
            target_mm=target.target_ct_mm,
            free_angle_deg=target.free_angle_deg,
            margin_mm=target.margin_mm,
        ).model_copy(update=changes)
        for target in SCENE.head.targets
    ]
    return Plan(
        schema=1,
        series_instance_uid=SERIES,
        patient_orientation=PatientPosition.HFS,
        implanted=len(CENTRES_CT_MM),
        fiducials=FiducialKind.FREE,
        tool="guide",
        standoff_mm=30.0,
        instrument_length_mm=250.0,
        trajectories=tuple(trajectories),
        fusion=FUSED if "fusion_error_mm" in changes else None,
    )


def far_away(one: PlannedTrajectory) -> PlannedTrajectory:
    """The same, below the table."""
    (x, y, z), (left, posterior, superior) = one.entry_mm, one.target_mm
    moved = {"entry_mm": (x, y + 900.0, z), "target_mm": (left, posterior + 900.0, superior)}
    return one.model_copy(update=moved)


def checked_plan(**changes: object) -> CheckedPlan:
    head = HeadEllipsoid(centre_mm=SCENE.head.centre_ct_mm, semi_axes_mm=SCENE.head.semi_axes_mm)
    return CheckedPlan(plan=plan(**changes), implanted=len(CENTRES_CT_MM), head=head, warnings=())


def checked_set_up(cell: RecordingCell) -> CheckedSetUp:
    return CheckedSetUp(
        identities={"arm": DeviceIdentity.from_identity(Identity("Test", "an arm", "1", "0"))},
        drivers={name: DriverSettings.of(table) for name, table in cell.theatre.devices.items()},
        notices=(),
        calibrations=cell.calibrations,
        tools=cell.theatre.tools,
        flange=cell.theatre.flange,
        cell=cell.theatre.cell_with_tools,
        settings=ProcedureSettings(),
        homes_rad={MASTER: cell.arm.joints_rad},
    )


def clamped_head() -> ClampedHead:
    return ClampedHead(patient_position=PatientPosition.HFS, spheres=4, implanted=4)


def locked_cart() -> LockedCart:
    return LockedCart(
        placings=1, moved_mm=(0.0, 0.0, 0.0), spheres=4, beside_mm=None, turned_deg=None, proposal=None
    )


def global_localization(points_mm: Array = SPHERES_MM) -> GlobalLocalization:
    """What the tracker saw from its place above the head."""
    points = tuple(points_mm.tolist())
    return GlobalLocalization(
        frames=60,
        points_robot_mm=points,
        points_tracker_mm=tuple((points_mm - TRACKER_MM).tolist()),
        spread_mm=(0.1,) * len(points),
        counts=(60,) * len(points),
        outliers=(0,) * len(points),
        rejected_strays=0,
        lost_readings=0,
        robot_from_tracker=FramedPose.of(Transform.of(Frame.ROBOT, Frame.TRACKER, translation_mm=TRACKER_MM)),
        joints_rad=HOME_RAD,
    )


def correspondence(robot_from_ct: Transform = ROBOT_FROM_CT) -> Correspondence:
    return Correspondence(
        status=MatchStatus.UNIQUE,
        pairs=tuple((number, number) for number in range(len(CENTRES_CT_MM))),
        robot_from_ct=FramedPose.of(robot_from_ct),
        residuals_mm=(0.1,) * len(CENTRES_CT_MM),
        margin_nats=None,
        two_way=NO_TABLE,
    )


def up_to_correspondence(cell: RecordingCell) -> tuple[StepResult, ...]:
    """What every step up to the coarse registration leaves."""
    before = (imported_ct(), localized_fiducials(), checked_plan(), checked_set_up(cell))
    return (*before, clamped_head(), locked_cart(), *coarse())


def coarse() -> tuple[StepResult, ...]:
    """What is known of the head before the stereo head has looked."""
    return (global_localization(), correspondence())


def checked_paths(
    cell: RecordingCell,
    *,
    robot_from_ct: Transform = ROBOT_FROM_CT,
    fiducials: Sequence[int] = (0, 1, 2, 3),
    turn_rad: float = 0.0,
) -> CheckedPaths:
    """Poses as the cell's strategy has them, in the branch of home, every trajectory turned alike."""
    turned = [
        replace(one, free_angle_rad=one.free_angle_rad + turn_rad)
        for one in place_guides(plan(), cell.workcell.tools.guide.bore)
    ]
    centres = CENTRES_CT_MM[list(fiducials)]
    arm = ArmInBranch(
        cell.workcell.master.arm.kinematics,
        cell.workcell.master.flange_from(MountedTool.GUIDE),
        cell.workcell.master.flange_from(MountedTool.STEREO_HEAD),
        cell.workcell.master.arm.kinematics.branch_of(HOME_RAD),
        HOME_RAD,
    )
    return CheckedPaths(
        strategy=cell.strategy.name,
        free_angle_turns_rad=dict.fromkeys(TRAJECTORIES, turn_rad),
        branch=None,
        joint_ranges_rad=(),
        largest_move_rad=0.0,
        motions=(),
        localizations={
            one.identifier: tuple(
                LocalizationPose(
                    fiducial=number,
                    tool_pose=FramedPose.of(pose),
                    approach_rad=joints_at(cell, back_along_axis(pose, APPROACH_MM)),
                    joints_rad=joints_at(cell, pose),
                )
                for number, pose in zip(
                    fiducials,
                    cell.strategy.localization_poses(one, centres, robot_from_ct, arm),
                    strict=True,
                )
            )
            for one in cell.strategy.localized_along(turned, centres, robot_from_ct)
        },
        targets={one.identifier: _target(cell, one, robot_from_ct) for one in turned},
    )


def _target(cell: RecordingCell, trajectory: Trajectory, robot_from_ct: Transform) -> TargetPose:
    pose = target_pose(trajectory, robot_from_ct)
    standoff = back_along_axis(pose, APPROACH_MM)
    return TargetPose(
        tool_pose=FramedPose.of(pose),
        approach_rad=joints_at(cell, standoff),
        joints_rad=joints_at(cell, pose),
        approach_signs=ARRIVING,
    )


def joints_at(cell: RecordingCell, pose: Transform) -> JointVector:
    """Joints that bring the checked tool to a pose, in the branch of home."""
    return cell.workcell.master.joints_at(pose, HOME_RAD)


def relocalization(points_mm: Array = SPHERES_MM) -> Relocalization:
    count = len(points_mm)
    return Relocalization(
        fiducials=tuple(range(count)),
        points_robot_mm=tuple(points_mm.tolist()),
        covariances_mm2=((np.eye(3) * SIGMA_MM**2).tolist(),) * count,
        residuals_mm=((0.01,),) * count,
        ray_gaps_mm=(0.01,) * count,
        radii_mm=((5.75, 5.75),) * count,
        looks=(1,) * count,
        joints_rad=(HOME_RAD,) * count,
        coarse_offset_mm=(0.0, 0.0, 0.0),
    )


def learned_arm(correction_mm: tuple[float, float, float]) -> LearnedArm:
    """Return an arm as stated, with this correction for the first target."""
    return LearnedArm(
        looks=5,
        share=1.0,
        scatter_mm=0.0,
        fiducials=(),
        spheres_robot_mm=(),
        corrections_mm={FIRST: correction_mm},
    )


def looks_with_tool_error(
    paths: CheckedPaths, tool_error_mm: Array, spheres_mm: Array = SPHERES_MM
) -> tuple[CheckedPaths, Relocalization]:
    """Return paths, and what their looks at spheres measure with a tool that is off its record."""
    localizations = {
        axis: tuple(one.model_copy(update={"approach_signs": ARRIVING}) for one in looks)
        for axis, looks in paths.localizations.items()
    }
    looks = [(axis, one) for axis, some in localizations.items() for one in some]
    tools = [one.tool_pose.transform.rotation_matrix @ tool_error_mm for _, one in looks]
    measured = relocalization(spheres_mm[[one.fiducial for _, one in looks]] - tools).model_copy(
        update={
            "fiducials": tuple(one.fiducial for _, one in looks),
            "axes": tuple(axis for axis, _ in looks),
        }
    )
    return paths.model_copy(update={"localizations": localizations}), measured


def registered_robot(robot_from_ct: Transform = ROBOT_FROM_CT) -> RegisteredRobot:
    return RegisteredRobot(
        robot_from_ct=FramedPose.of(robot_from_ct),
        pairs=len(CENTRES_CT_MM),
        fre_mm=0.1,
        residuals_mm=((0.0, 0.0, 0.0),) * len(CENTRES_CT_MM),
        leave_one_out_mm=(None,) * len(CENTRES_CT_MM),
        predictions=tuple(
            Prediction(target=name, rms_mm=0.2, limit_mm=0.4, confidence=0.95, formula="")
            for name in TRAJECTORIES
        ),
        two_way=NO_TABLE,
    )


def before_positioning(
    cell: ClinicalCell,
    registered: StepSpec[StepResult] | StepResult | None = None,
    **paths: Any,
) -> Engine:
    """An engine that stands before the first positioning, with the guide mounted; work and retreat follow."""
    cell.carrying(MountedTool.GUIDE)
    engine = cell.begin(
        *(registered or registered_robot(), mounted_guide(), checked_tool(), checked_paths(cell, **paths)),
        *(checked_plan(), localized_fiducials(), *coarse()),
        *(positioning.STEP, at_target.STEP, retreat.STEP),
    )
    engine.run_to(engine.order.sequence[7])
    return engine


def mounted_guide() -> MountedGuide:
    return MountedGuide(tool_number=GUIDE, calibration="tip-1", link=LINK)


def checked_tool() -> CheckedTool:
    return CheckedTool(
        tool_record="tool-guide",
        readings_mm=((0.0,) * 5,) * 2,
        offset_mm=(0.0, 0.0, 0.0),
        off_mm=0.0,
        tilt_deg=0.0,
        joints_rad=HOME_RAD,
    )
