"""A run with all that an export can hold: reached, in a simulated theatre, and found in a later CT."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from clinical_case import FIRST, ROBOT_FROM_CT, ClinicalCell
from finished_runs import recorded_run
from prepared_results import (
    SERIES,
    checked_plan,
    checked_set_up,
    imported_ct,
    localized_fiducials,
    registered_robot,
)

from procedures.engine.case import StepKey
from procedures.journal.results import FramedPose
from procedures.planning.guide import depth_stop_mm, place_guide
from procedures.planning.plan_model import PlannedTrajectory
from procedures.postoperative.comparison import FoundKind, FoundTrajectory
from procedures.postoperative.summary import PostoperativeCheck
from procedures.reporting.outcome import TargetTruth, Truth
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.work_progress import DepthStop
from procedures.strategies.trajectory import target_pose

IMPORTED = imported_ct()
SPHERES = localized_fiducials(np.array([[1.0, 2.0, 3.0]]))
PLAN = checked_plan()
TOO_DEEP_MM = 0.05
TRUE = TargetTruth(id=FIRST, application_error_mm=0.5, lateral_mm=0.3, axial_mm=-0.4)
IN_CT = ((StepKey("ct_import"), IMPORTED), (StepKey("fiducial_localization"), SPHERES))


def whole_run(folder: Path) -> Path:
    """A run with all that an export can hold: reached, in a simulated theatre, and found in a later CT."""
    cell = ClinicalCell(folder.parent / "cell")
    bore, planned = cell.theatre.tools["guide"].bore, PLAN.plan.trajectories[0]
    assert bore is not None
    computed_mm = depth_stop_mm(PLAN.plan, planned, bore)
    reached = ReachedTarget(
        tool_pose=FramedPose.of(target_pose(place_guide(PLAN.plan, planned, bore), ROBOT_FROM_CT)),
        nominal_error_mm=TOO_DEEP_MM,
        too_deep_mm=TOO_DEEP_MM,
        depth_stop=DepthStop(
            bore_mm=bore.length_mm,
            standoff_mm=PLAN.plan.standoff_mm,
            depth_mm=planned.depth_mm,
            computed_mm=computed_mm,
            read_mm=computed_mm + TOO_DEEP_MM,
        ),
        pushed_mm=0.0,
    )
    (folder / "report").mkdir(parents=True)
    (folder / "report" / "truth.json").write_text(Truth(targets=(TRUE,)).model_dump_json())
    (folder / "report" / "postoperative.json").write_text(
        PostoperativeCheck(
            schema=1,
            pre_series_instance_uid=SERIES,
            post_series_instance_uid="1.2.9",
            post_from_pre=((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)),
            bone_agreement=1.0,
            bone_overlap=1.0,
            trajectories=(found_in_later_ct(planned),),
        ).model_dump_json(by_alias=True)
    )
    return recorded_run(
        folder,
        *(*IN_CT, (StepKey("plan_check"), PLAN), (StepKey("set_up"), checked_set_up(cell))),
        (StepKey("registration"), registered_robot()),
        (StepKey("at_target", FIRST), reached),
        opened={"banner": "SIMULATED THEATRE"},
    )


def found_in_later_ct(planned: PlannedTrajectory) -> FoundTrajectory:
    (x, y, z) = planned.target_mm
    return FoundTrajectory(
        id=planned.id,
        kind=FoundKind.INSTRUMENT,
        planned_entry_mm=planned.entry_mm,
        planned_target_mm=planned.target_mm,
        entry_mm=planned.entry_mm,
        axis_at_target_mm=(x + 1.0, y, z),
        tip_mm=(x + 1.0, y, z),
        entry_error_mm=0.0,
        target_error_mm=1.0,
        lateral_mm=0.8,
        depth_error_mm=0.6,
        angle_deg=1.0,
    )
