"""The guide is checked on the gauge before it goes near the head, and its record must fit."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from clinical_case import FIRST, ClinicalCell
from coded_errors import raises
from prepared_results import checked_plan, coarse, localized_fiducials, mounted_guide
from recording_cell import RecordingOperator

from procedures.guards.stability import GUIDE_NOTICEABLE_MM
from procedures.journal.errors import StepRefused
from procedures.journal.journal import JOURNAL_FILE, read_journal
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import Task, Topic
from procedures.planning.errors import FOREIGN_TOOL, NO_TOOL_RECORD
from procedures.planning.tool_records import ToolRecords
from procedures.steps.clinical import positioning
from procedures.steps.clinical.tool_check import APPROACHES, STEP, CheckedTool
from procedures.steps.errors import ReadingTooOld, ToolBesideGauge
from procedures.workcell import MountedTool
from procedures.workcell.errors import INSTRUMENT_IN_GUIDE
from ronna_hw.calibration import CalibrationExpired
from ronna_hw.tool_record import TipInHead, ToolPurpose
from ronna_hw.wire.room_tasks import GAUGE, OUT

MOST_APPROACHES = 2 * APPROACHES  # of a guide that differs after the first half
NOW = datetime(2031, 1, 1, tzinfo=UTC)


def check(cell: ClinicalCell, *beside_mm: float) -> CheckedTool:
    """With dials that read so far beside the record."""
    cell.carrying(MountedTool.GUIDE)
    gauge = cell.workcell.tools.guide.gauge
    recorded_mm = (*gauge.reading_mm, *gauge.upper_reading_mm)
    cell.room.dials_mm = tuple(there + off for there, off in zip(recorded_mm, beside_mm, strict=False))
    cell.run(mounted_guide(), *coarse(), checked_plan(), localized_fiducials(), STEP)
    return cell.case.get(CheckedTool).result


def test_the_arm_approaches_the_gauge_from_the_same_side_and_returns_home(cell: ClinicalCell) -> None:
    checked = check(cell, 0.02, 0.0, 0.02, 0.02, 0.0)
    ways = [to for _, to in cell.arm.motions]
    *at_gauge, home = ways[1::2]
    for back, there in zip(ways[::2], ways[1::2], strict=True):
        assert all(before < after for before, after in zip(back, there, strict=True))
    assert at_gauge == [checked.joints_rad] * APPROACHES
    assert home == cell.workcell.master.home_rad
    assert checked.off_mm == pytest.approx(0.0283, abs=1e-4)
    assert checked.tilt_deg == 0.0


@pytest.mark.hazard(47)
@pytest.mark.branch("TOOL_BESIDE_GAUGE")
@pytest.mark.parametrize(
    "dials_mm",
    [
        (1.2 * GUIDE_NOTICEABLE_MM, 0.0, 0.0, 0.0, 0.0),  # bent
        (0.0, 0.0, -1.2 * GUIDE_NOTICEABLE_MM, 0.0, 0.0),  # not seated
        (0.0, 0.0, 0.0, 0.12, 0.0),  # tilted: 0.11 deg on 60 mm
    ],
)
def test_a_guide_that_deviates_from_its_record_is_refused_with_the_arm_at_home(
    cell: ClinicalCell, dials_mm: tuple[float, ...]
) -> None:
    with pytest.raises(ToolBesideGauge, match=r"TOOL-005: .*limit 0\.05 mm, 0\.1 deg"):
        check(cell, *dials_mm)
    assert cell.workcell.master.place.is_home
    assert not cell.workcell.master.streaming  # hands seat the guide anew
    assert [task.name for task in cell.room.worked].count(GAUGE) == 2 * MOST_APPROACHES  # mounted twice


@pytest.mark.hazard(47)
@pytest.mark.parametrize(("later_mm", "approaches"), [(0.0, 6), (0.03, 6), (0.036, 6)])
def test_readings_that_differ_are_taken_again_and_the_mean_of_six_decides(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch, later_mm: float, approaches: int
) -> None:
    work = cell.room.work

    def beside(task: Task) -> tuple[float, ...]:
        read = work(task)
        if task.name != GAUGE:
            return read
        first_three = [one.name for one in cell.room.worked].count(GAUGE) <= APPROACHES
        off_mm = 0.06 if first_three else later_mm
        return (read[0] + off_mm, *read[1:3], read[3] + off_mm, read[4])

    monkeypatch.setattr(cell.room, "work", beside)
    checked = check(cell, *(0.0,) * 5)
    assert len(checked.readings_mm) == approaches
    assert checked.off_mm <= GUIDE_NOTICEABLE_MM
    assert not [question for question in cell.operator.asked if question.topic is Topic.TOOL_CHANGE]


@pytest.mark.hazard(47)
def test_a_guide_that_comes_right_when_it_is_mounted_again_is_accepted(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    def seated_well(number: int, _description: str) -> None:
        assert (number, cell.workcell.master.streaming) == (2, False)
        cell.room.dials_mm = tuple(dial - 0.06 for dial in cell.room.dials_mm)

    monkeypatch.setattr(cell.room, "change_tool", seated_well)
    assert check(cell, *(0.06,) * 5).off_mm == pytest.approx(0.0)
    again = [question for question in cell.operator.asked if question.topic is Topic.TOOL_CHANGE]
    assert [question.subject for question in again] == [
        "The guide differs from its record. Is it mounted again?"
    ]
    (finding,) = [line for line in read_journal(cell.folder / JOURNAL_FILE) if line["entry"] == "finding"]
    assert "limit 0.05 mm, 0.1 deg, got 0.104 mm" in finding["text"]


@pytest.mark.hazard(47)
@pytest.mark.branch("TOOL_BESIDE_GAUGE")
def test_a_guide_that_is_not_mounted_again_is_refused_at_once(cell: ClinicalCell) -> None:
    cell.operator = RecordingOperator(Topic.TOOL_CHANGE)
    with pytest.raises(ToolBesideGauge):
        check(cell, *(0.06,) * 5)
    assert [task.name for task in cell.room.worked].count(GAUGE) == MOST_APPROACHES


@pytest.mark.hazard(47)
@pytest.mark.parametrize(
    ("read_mm", "said"),
    [((), "no readings were given"), ((math.nan, *(0.0,) * 4), "the readings are not finite numbers")],
)
def test_a_check_without_finite_gauge_readings_is_refused(
    cell: ClinicalCell, read_mm: tuple[float, ...], said: str
) -> None:
    with pytest.raises(NotConfirmed, match=f"PRO-002: {said}"):
        check(cell, *read_mm)


@pytest.mark.hazard(44)
def test_the_arm_is_stopped_while_hands_push_the_mandrel_into_the_gauge(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    stops: list[int] = []
    work = cell.room.work

    def seen(task: Task) -> tuple[float, ...]:
        stops.append(cell.arm.stops)
        return work(task)

    monkeypatch.setattr(cell.room, "work", seen)
    check(cell, *(0.0,) * 5)
    assert [task.name for task in cell.room.worked] == [GAUGE, OUT] * 3
    assert stops == [1, 1, 2, 2, 3, 3]  # one for each approach, before anybody works there


@pytest.mark.hazard(44)
@pytest.mark.parametrize("dials_mm", [(0.0,) * 5, ()], ids=["read", "not read"])
def test_the_arm_does_not_leave_the_gauge_before_the_mandrel_is_out(
    cell: ClinicalCell, dials_mm: tuple[float, ...]
) -> None:
    cell.operator = RecordingOperator(Topic.INSTRUMENT_OUT)
    with pytest.raises(NotConfirmed):
        check(cell, *dials_mm)
    assert len(cell.arm.motions) == 2  # over to the gauge
    with raises(INSTRUMENT_IN_GUIDE, match="TOOL-001: home: an instrument is in the guide, and in the gauge"):
        cell.workcell.master.return_home()


@pytest.mark.hazard(36)
@pytest.mark.parametrize(
    ("topic", "said", "motions"),
    [
        (Topic.TOOL_CHECK, "Move the guide over to the gauge.*without a terminal needs", 0),
        (
            Topic.PARK,
            "PRO-002: .*from the gauge\\?.: first: the guide moves .* mm; .* mm/s",
            2 * APPROACHES,
        ),  # none home
    ],
)
def test_the_gauge_is_neither_approached_nor_left_without_confirmation(
    cell: ClinicalCell, topic: Topic, said: str, motions: int
) -> None:
    cell.operator = RecordingOperator(topic)
    with pytest.raises(NotConfirmed, match=said):
        check(cell, *(0.0,) * 5)
    assert len(cell.arm.motions) == motions


@pytest.mark.hazard(47)
def test_dials_read_an_hour_before_the_result_are_refused(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("procedures.steps.conditions.LONGEST_S", 0.0)
    with pytest.raises(ReadingTooOld, match="TOOL-007: the dials of the gauge: read too long ago"):
        check(cell, *(0.0,) * 5)
    assert cell.workcell.master.place.is_home


@pytest.mark.hazard(47)
def test_the_guide_is_not_positioned_without_the_tool_check(cell: ClinicalCell) -> None:
    cell.carrying(MountedTool.GUIDE)
    engine = cell.begin(
        *(mounted_guide(), *coarse(), checked_plan(), localized_fiducials()), STEP, positioning.STEP
    )
    engine.run_to(engine.order.sequence[4])
    with pytest.raises(StepRefused, match=r"PRO-001: .*tool_check comes first"):
        engine.run_step(engine.order.find(f"positioning:{FIRST}"))


def records(cell: ClinicalCell, **changes: object) -> ToolRecords:
    """The tools of the cell, valid at `NOW`, with the guide's record changed."""
    dated = {"created": NOW - timedelta(days=1), "expires": NOW + timedelta(days=1)}
    tools = cell.workcell.tools
    found = {name: one.model_copy(update=dated) for name, one in tools.records.items()}
    return replace(tools, records={**found, "guide": found["guide"].model_copy(update=changes)})


Damage = Callable[[ClinicalCell], ToolRecords]
UNFIT: dict[str, tuple[Damage, type[Exception], str]] = {
    "expired": (
        lambda cell: records(cell, expires=NOW - timedelta(hours=1)),
        CalibrationExpired,
        "CAL-001: tool record tool-guide-mini-3 expired",
    ),
    "another flange": (
        lambda cell: records(cell, flange="changer 7"),
        FOREIGN_TOOL,
        "TOOL-003: .*another flange; expected changer of the simulated arm, got changer 7",
    ),
    "another tip": (
        lambda cell: records(cell, tip="tool-tip-of-may"),
        FOREIGN_TOOL,
        "TOOL-003: .*another calibration of its tip",
    ),
    "the same tip with other numbers": (
        lambda cell: records(
            cell, tip_in_head=TipInHead(translation_mm=(0.0, 0.0, 0.0), quaternion_wxyz=(1.0, 0.0, 0.0, 0.0))
        ),
        FOREIGN_TOOL,
        "TOOL-003: tool-tip-mini-3 has other numbers .* limit 0.001 mm, 0.001 deg",
    ),
    "another number": (lambda cell: records(cell, number=5), NO_TOOL_RECORD, "TOOL-002: .*expected 2, got 5"),
    "no guide": (
        lambda cell: records(cell, purpose=ToolPurpose.GRIPPER),
        NO_TOOL_RECORD,
        "TOOL-002: .*not that of a guide",
    ),
    "none": (
        lambda cell: replace(records(cell), records={}),
        NO_TOOL_RECORD,
        r"TOOL-002: .*no record of the guide.*\[tools.guide\]",
    ),
}


@pytest.mark.hazard(47)
@pytest.mark.parametrize("what", UNFIT)
def test_a_tool_record_that_does_not_fit_is_refused(cell: ClinicalCell, what: str) -> None:
    damage, error, said = UNFIT[what]
    records(cell).check(cell.calibrations, NOW)
    with raises(error, match=said):
        damage(cell).check(cell.calibrations, NOW)
