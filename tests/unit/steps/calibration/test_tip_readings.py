"""The guide goes to the divot only after a confirmed exchange, in the orientations used at the ball."""

from __future__ import annotations

import numpy as np
import pytest
from clinical_case import IN_VIEW_MM, ClinicalCell
from coded_errors import raises
from prepared_results import checked_set_up
from recording_cell import GUIDE, RecordingOperator

from procedures.calibration.errors import NO_BALL, POSES_OUT_OF_REACH, READING_IMPLAUSIBLE
from procedures.calibration.tip_calibration import TipLooks, calibrate_tip
from procedures.engine.questions import IN_DIVOT
from procedures.journal.journal import JOURNAL_FILE, read_journal
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import Topic
from procedures.relocalization.errors import SphereNotInView
from procedures.steps.calibration.ball_place import BallPlace
from procedures.steps.calibration.tip_readings import readings_step, stand_place_step, stand_step
from procedures.workcell import MountedTool
from procedures.workcell.arm_history import arm_history
from procedures.workcell.errors import INSTRUMENT_IN_GUIDE, WrongTool
from ronna_hw.frames import Frame
from ronna_hw.vectors import JointVector

BALL_MM = (650.0, -200.0, 250.0)
BESIDE_MM = (0.4, -0.3, 0.6)  # the true tip beside its record, in the tool frame of the head
COUNT, VALIDATION = 11, 3
Numbers3 = tuple[float, float, float]


def stand(cell: ClinicalCell) -> None:
    """A stand whose dials show the true tip on the cell's arm."""
    head = cell.calibrations.stereo_head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    guide = cell.calibrations.tool_tip.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    tip = guide.translation_mm + head.rigid.rotation.apply(BESIDE_MM)

    def dials(joints: JointVector) -> Numbers3:
        x, y, z = (cell.arm.kinematics.flange_pose(joints).apply(tip) - BALL_MM).tolist()
        return (x, y, z)

    cell.room.dials = dials
    cell.workcell.spheres_mm = np.array([BALL_MM])


def read(cell: ClinicalCell, ball_mm: Numbers3 = BALL_MM) -> TipLooks:
    cell.carrying(MountedTool.STEREO_HEAD)
    place = BallPlace(ball_mm=ball_mm, others_mm=())
    steps = (stand_step(COUNT), readings_step(VALIDATION))
    return cell.run(checked_set_up(cell), place, *steps).result.observed


def test_the_readings_recover_the_tip_of_the_cell(cell: ClinicalCell) -> None:
    stand(cell)
    observed = read(cell)
    assert len(observed.readings) == COUNT
    assert len(observed.validation) == VALIDATION
    assert max(abs(value) for one in observed.readings for value in one.dials_mm) < 0.3
    head = cell.calibrations.stereo_head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    guide = cell.calibrations.tool_tip.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    true = (head.inverse() @ guide).translation_mm + BESIDE_MM
    assert np.linalg.norm(calibrate_tip(observed).fit.tip_mm - true) < 0.01


def test_the_order_is_ball_then_guide_then_divot(cell: ClinicalCell) -> None:
    stand(cell)
    read(cell)
    assert cell.room.stand == ["ball", "divot"]
    assert [number for number, _, _ in cell.room.changed] == [GUIDE]
    assert cell.workcell.master.place.is_home


@pytest.mark.parametrize("topic", [Topic.CALIBRATION, Topic.TOOL_CHANGE])
def test_nothing_moves_after_an_unconfirmed_calibration_or_tool_change(
    cell: ClinicalCell, topic: Topic
) -> None:
    stand(cell)
    cell.operator, motions = RecordingOperator(topic), []
    cell.operator.meanwhile = lambda _question: motions.append(len(cell.arm.motions))
    with pytest.raises(NotConfirmed):
        read(cell)
    assert len(cell.arm.motions) == motions[-1]


@pytest.mark.hazard(44)
def test_the_arm_stands_still_while_hands_are_at_the_divot_until_it_is_confirmed_lowered(
    cell: ClinicalCell,
) -> None:
    stand(cell)
    dials, motions, stops = cell.room.dials, [], []

    def read_then_refuse(joints: JointVector) -> Numbers3:
        motions.append(len(cell.arm.motions))
        stops.append(cell.arm.stops)
        cell.operator.refusing = (Topic.INSTRUMENT_OUT,)
        return dials(joints)

    cell.room.dials = read_then_refuse
    before = cell.arm.stops
    with pytest.raises(NotConfirmed, match="lower the divot from the guide"):
        read(cell)
    assert motions == [len(cell.arm.motions)]
    assert stops == [before + 1]
    assert "are hands clear of it" in cell.operator.asked[-1].subject
    with raises(INSTRUMENT_IN_GUIDE, match=r"TOOL-001: home: .*in the divot"):
        cell.workcell.master.go_home()
    assert arm_history(read_journal(cell.folder / JOURNAL_FILE)).place.instrument_may_be_inside == IN_DIVOT


def test_a_stand_without_its_ball_is_refused_with_its_position_and_the_keys_that_state_it(
    cell: ClinicalCell,
) -> None:
    stand(cell)
    cell.workcell.spheres_mm = np.array([BALL_MM]) + 10 * IN_VIEW_MM
    with pytest.raises(SphereNotInView, match=r"STE-009.*stand's ball.*15 mm of 650 -200 250 mm") as refused:
        read(cell)
    for remedy in ("Seat the ball", "--ball X Y Z", "stand_mm in [procedure]"):
        assert remedy in refused.value.advice


@pytest.mark.hazard(37)
def test_a_tool_other_than_the_guide_is_refused(cell: ClinicalCell) -> None:
    stand(cell)
    cell.room.mounts = 7
    motions: list[int] = []
    cell.operator.meanwhile = lambda _question: motions.append(len(cell.arm.motions))
    with pytest.raises(WrongTool, match="PRO-009"):
        read(cell)
    assert len(cell.arm.motions) == motions[-1]  # none towards the divot


def test_an_implausible_reading_is_refused(cell: ClinicalCell) -> None:
    stand(cell)
    cell.room.dials = lambda _joints: (0.0, 350.0, 0.0)
    with raises(READING_IMPLAUSIBLE, match="CAL-018"):
        read(cell)


def test_a_stand_out_of_reach_is_refused_before_the_operator_is_asked(cell: ClinicalCell) -> None:
    stand(cell)
    with raises(POSES_OUT_OF_REACH, match="CAL-010"):
        read(cell, (2000.0, 0.0, 300.0))
    assert cell.operator.asked == []


def test_a_missing_stand_position_is_refused_and_the_option_named(cell: ClinicalCell) -> None:
    with raises(NO_BALL, match="CAL-009") as refused:
        cell.run(stand_place_step())
    assert "--ball X Y Z" in refused.value.action
