"""The operation of a case, left after a step, and what may be swapped before it is resumed."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from clinical_case import FIRST, ClinicalCell, given
from prepared_results import (
    checked_paths,
    checked_plan,
    checked_set_up,
    checked_tool,
    correspondence,
    global_localization,
    localized_fiducials,
    mounted_guide,
    registered_robot,
    relocalization,
)
from run_again import broken_off, opened_again

from procedures.engine.engine import Engine
from procedures.engine.order import CaseOrder, Scope, StepSpec, order_of
from procedures.journal.results import StepResult
from procedures.operator.question import Answer, Question, Topic
from procedures.runs.interrupted_run import InterruptedRun
from procedures.steps.clinical import at_target, confirmation, positioning, retreat
from procedures.steps.clinical.set_up import DeviceIdentity
from procedures.workcell import MountedTool
from ronna_hw.config import Calibrations
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.vectors import JointVector


def per_trajectory(result: StepResult) -> StepSpec[StepResult]:
    return replace(given(result), scope=Scope.LOCALIZATION)


def case_order(cell: ClinicalCell) -> CaseOrder:
    """The operation of a case, with everything before it given."""
    set_up = checked_set_up(cell).model_copy(
        update={
            "identities": {
                role: DeviceIdentity.from_identity(Identity("Test", f"a {role}", "1", "0"))
                for role in ("tracker", "arm", "stereo")
            }
        }
    )
    before = [
        given(one)
        for one in (localized_fiducials(), checked_plan(), set_up, global_localization(), correspondence())
    ]
    localized = [per_trajectory(one) for one in (relocalization(), registered_robot())]
    steps = [*before, given(checked_paths(cell)), *localized, given(mounted_guide()), given(checked_tool())]
    return order_of([*steps, positioning.STEP, at_target.STEP, retreat.STEP, confirmation.STEP], [FIRST])


@dataclass(frozen=True)
class LeftOperation:
    """Files that an operation left, by their names in the run folder, and where the arm stood."""

    files: dict[Path, bytes]
    joints_rad: JointVector
    mounted: int


@cache
def _operation_left_after(last: str, pickled_theatre: bytes) -> LeftOperation:
    with TemporaryDirectory() as place:
        cell = ClinicalCell(Path(place) / "run", pickle.loads(pickled_theatre))
        cell.carrying(MountedTool.GUIDE)
        order = case_order(cell)
        cell.engine(order).run_to(order.find(last))
        broken_off(cell)
        files = {
            path.relative_to(cell.folder): path.read_bytes()
            for path in cell.folder.rglob("*")
            if path.is_file()
        }
        return LeftOperation(files, cell.arm.joints_rad, cell.arm.mounted)


def left_after(cell: ClinicalCell, last: str) -> tuple[ClinicalCell, Engine, InterruptedRun]:
    """An operation of which a cell that has just been made has the files, opened again."""
    assert cell.arm.motions == []
    broken_off(cell)
    left = _operation_left_after(last, pickle.dumps(cell.theatre))
    for name, content in left.files.items():
        (cell.folder / name).parent.mkdir(exist_ok=True)
        (cell.folder / name).write_bytes(content)
    cell.arm.joints_rad, cell.arm.mounted = left.joints_rad, left.mounted
    return opened_again(cell, case_order(cell))


def other_arm(cell: ClinicalCell) -> None:
    cell.arm.name = "another arm"


def other_calibration(cell: ClinicalCell) -> None:
    calibrations: Calibrations = cell.calibrations
    tip = calibrations.tool_tip.model_copy(update={"stated_error_mm": 0.5})
    cell.workcell.calibrations = calibrations.model_copy(update={"tool_tip": tip})


def other_frame(cell: ClinicalCell) -> None:
    calibrations: Calibrations = cell.calibrations
    frame = calibrations.tracker_frame.model_copy(update={"identifier": "renewed"})
    cell.workcell.calibrations = calibrations.model_copy(update={"tracker_frame": frame})


def left_with_an_instrument_inside(
    cell: ClinicalCell, order: CaseOrder
) -> tuple[ClinicalCell, Engine, InterruptedRun]:
    """Killed while someone works through the guide."""
    ask = cell.operator.ask

    def killed(question: Question) -> Answer:
        if question.topic is Topic.DURA:
            raise MemoryError
        return ask(question)

    cell.operator.ask = killed  # type: ignore[method-assign]
    with pytest.raises(MemoryError):
        cell.engine(order).run_to()
    broken_off(cell)
    return opened_again(cell, order)
