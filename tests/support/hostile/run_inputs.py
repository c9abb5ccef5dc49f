"""Results of a finished run, changed by who may write everything, and what reads them."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path

from clinical_case import FIRST, HOME_RAD, ClinicalCell, given
from good_inputs import Take
from prepared_results import (
    LINK,
    checked_paths,
    checked_tool,
    mounted_guide,
    registered_robot,
    relocalization,
    up_to_correspondence,
)

from procedures.journal.journal import JOURNAL_FILE, Entry, read_journal
from procedures.journal.results import FramedPose, StepResult, parse_record
from procedures.registration.verification import CtToRoomRow, MeasuringInstrument, RoomToCtRow
from procedures.reporting.case_figures import read_case_figures
from procedures.reporting.files import SUMMARY_FILE, load_check
from procedures.reporting.outcome import TargetTruth, Truth
from procedures.reporting.report import write_report
from procedures.reporting.run_reading import read_for_report
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.path_check import ClosestApproach, MotionPreview
from procedures.steps.clinical.results import ErrorShare, LeftOutSphere
from procedures.steps.clinical.retreat import Retreated
from procedures.steps.clinical.target_measurement import MeasuredTarget
from procedures.steps.clinical.work_progress import DepthStop
from procedures.workcell import MountedTool
from ronna_hw.bounded_input import parse_json
from ronna_hw.evidence.journal_reading import FIRST as NO_LINE
from ronna_hw.frames import Frame, Transform
from ronna_hw.records import Record, read_record, write_record

TRUTH = Truth(targets=(TargetTruth(id=FIRST, application_error_mm=0.4, lateral_mm=0.4, axial_mm=-0.1),))
CHECK = {
    "schema": 1,
    "pre_series_instance_uid": "1.2",
    "post_series_instance_uid": "1.3",
    "post_from_pre": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
    "bone_agreement": 0.9,
    "bone_overlap": 0.95,
    "trajectories": [
        {
            "id": FIRST,
            "kind": "instrument",
            "planned_entry_mm": [1, 2, 3],
            "planned_target_mm": [1, 2, 43],
            "entry_mm": [1, 2.5, 3],
            "axis_at_target_mm": [1, 2.2, 43],
            "tip_mm": None,
            "entry_error_mm": 0.5,
            "target_error_mm": None,
            "lateral_mm": 0.2,
            "depth_error_mm": -0.1,
            "angle_deg": 1.5,
            "doubts": ["it is short"],
        }
    ],
    "warnings": ["thick slices"],
}


def run_parsers(folder: Path) -> dict[str, tuple[tuple[bytes, ...], Take]]:
    """What each takes when all is well, and what takes it; `folder` is theirs."""
    folder.mkdir()
    run = _finished(folder / "20261120T000000-s3-abcd")
    records = tuple(read_record(path) for path in sorted((run / "records").glob("*.json")))
    lines = tuple(read_journal(run / JOURNAL_FILE))
    changes = tuple({"record": one.identifier, "payload": one.payload} for one in records)

    def changed(data: bytes) -> None:
        change = parse_json(data)
        ours = next((one for one in records if one.identifier == change["record"]), records[0])
        new = replace(ours, payload=dict(change["payload"]))
        _rewrite(run, lines, [new if one is ours else one for one in records])
        write_report(run, truth=TRUTH, out=folder / "out")
        read_case_figures(run)
        parse_record(new, _MODELS[new.kind])

    # Of a run without records: those would be read anew for each check, which does not need them.
    opened = _opened(folder / "20261120T000000-s3-ef01").journal.path.parent
    (opened / "report").mkdir()

    def checked(data: bytes) -> None:
        (opened / "report" / SUMMARY_FILE).write_bytes(data)
        if load_check(read_for_report(opened, every_file=False)) is not None:
            write_report(opened, out=folder / "out")

    return {
        "results of a run": (tuple(json.dumps(one).encode() for one in changes), _if_readable(changed)),
        "check after the operation": ((json.dumps(CHECK).encode(),), checked),
    }


def _if_readable(take: Take) -> Take:
    def read(data: bytes) -> None:
        try:
            change = parse_json(data)
        except ValueError:
            return
        if isinstance(change, dict) and isinstance(change.get("payload"), dict) and "record" in change:
            take(data)

    return read


_MODELS: dict[str, type[StepResult]] = {}


def _results(cell: ClinicalCell) -> list[StepResult]:
    paths = checked_paths(cell)
    motion = MotionPreview(
        start="home",
        end=f"{FIRST}/fiducial 0",
        kind="move",
        duration_s=1.0,
        clear=True,
        closest=ClosestApproach(first="head", second="table", distance_mm=25.0, at=0.5),
        largest_joint_speed_share=0.5,
        largest_speed_mm_s=100.0,
        nearest_to_head_mm=30.0,
    )
    fit = registered_robot()
    table = fit.two_way.model_copy(
        update={
            "ct_to_room": (
                CtToRoomRow(
                    fiducial=0,
                    ct_disagreement_mm=0.01,
                    tracker_index=0,
                    tracker_residual_mm=0.1,
                    stereo_residual_mm=None,
                    leave_one_out_mm=0.2,
                    partner_is_nearest=True,
                ),
            ),
            "room_to_ct": (
                RoomToCtRow(
                    instrument=MeasuringInstrument.TRACKER,
                    index=0,
                    fiducial=None,
                    nearest_fiducial=0,
                    distance_mm=0.1,
                ),
            ),
        }
    )
    budget = tuple(
        one.model_copy(update={"budget": (ErrorShare(source="CT", rms_mm=0.2),)}) for one in fit.predictions
    )
    health = LINK.model_copy(
        update={
            "cycles": 5,
            "histogram_edges_us": (0.0, 10.0, 100.0),
            "histogram_counts": (3, 2),
            "jitter_counts": (5, 0),
        }
    )
    pose = FramedPose.of(Transform.of(Frame.ROBOT, Frame.TOOL))
    return [
        *up_to_correspondence(cell),
        paths.model_copy(update={"motions": (motion,), "left_out": {"T9": "it is out of reach"}}),
        relocalization().model_copy(update={"left_out": (LeftOutSphere(fiducial=4, reason="hidden"),)}),
        fit.model_copy(
            update={
                "two_way": table,
                "predictions": budget,
                "left_out_spheres": (LeftOutSphere(fiducial=3, reason="far off"),),
            }
        ),
        mounted_guide().model_copy(update={"link": health}),
        checked_tool(),
        MeasuredTarget(
            tool_pose=pose,
            error_mm=0.1,
            ball_tool_mm=(0.0, 0.1, 0.0),
            covariance_mm2=None,
            joints_rad=HOME_RAD,
        ),
        ReachedTarget(
            tool_pose=pose,
            nominal_error_mm=0.1,
            too_deep_mm=0.0,
            depth_stop=DepthStop(
                bore_mm=50.0, standoff_mm=30.0, depth_mm=40.0, computed_mm=120.0, read_mm=120.0
            ),
            pushed_mm=0.1,
            done_before=("drill",),
        ),
        Retreated(joints_rad=HOME_RAD, link=health),
    ]


def _opened(folder: Path) -> ClinicalCell:
    cell = ClinicalCell(folder)
    opening = {"theatre": "mini scene, seed 3", "banner": "SIMULATED THEATRE", "strategy": "ocs", "seed": 3}
    cell.journal.write(Entry.OPENED, 0.0, **opening)
    return cell


def _finished(folder: Path) -> Path:
    cell = _opened(folder)
    cell.carrying(MountedTool.STEREO_HEAD)
    results = _results(cell)
    _MODELS.update({one.kind: type(one) for one in results})
    engine = cell.begin(*map(given, results))
    engine.run_to()
    engine.close("done")
    return folder


def _rewrite(run: Path, lines: tuple[dict[str, object], ...], records: list[Record]) -> None:
    """As who may write everything: hashes and chain are made anew over what was changed."""
    hashes: dict[str, str] = {}
    for one in records:
        new = replace(one, parents={name: hashes[name] for name in one.parents})
        (run / "records" / f"{one.identifier}.json").unlink(missing_ok=True)
        write_record(new, run / "records")
        hashes[one.identifier] = new.sha256
    previous, content = NO_LINE, b""
    for number, line in enumerate(lines):
        if line.get("record") in hashes:
            line = {**line, "sha256": hashes[str(line["record"])]}
        text = json.dumps({**line, "sequence": number, "previous": previous}).encode() + b"\n"
        previous, content = hashlib.sha256(text).hexdigest(), content + text
    (run / JOURNAL_FILE).write_bytes(content)
