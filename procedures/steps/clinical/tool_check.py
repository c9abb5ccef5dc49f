"""Gauge check of the mounted guide: does it still match its tip calibration?

The gauge is at the former place of the mandrel's end, with the arm in the recorded joints, reached from the
same side. So the arm's repeatability counts, not its accuracy. Hands insert the mandrel and read the dials.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.engine.questions import IN_GAUGE
from procedures.guards.room_reading import CAREFUL_FRAMES
from procedures.guards.stability import guide_noticeable_mm
from procedures.journal.results import StepResult
from procedures.operator.question import NO, YES, Task, Topic
from procedures.steps.branches import TOOL_BESIDE_GAUGE
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.room import ROOM_READS, check_room, doubt
from procedures.steps.clinical.surroundings import READS, planning_scene_of
from procedures.steps.clinical.tool_change import MountedGuide
from procedures.steps.clinical.tool_mounting import require_seen_in_place
from procedures.steps.conditions import needs_tool, require_recent
from procedures.steps.errors import ToolBesideGauge
from procedures.strategies.strategy import ONE_SIDE
from procedures.workcell import MountedTool
from ronna_hw.arm.pose import radians6
from ronna_hw.calibration import Numbers3
from ronna_hw.tool_record import Gauge
from ronna_hw.vectors import JointVector
from ronna_hw.wire.room_tasks import GAUGE

# 0.1 degrees move the end of an instrument 100 mm long by 0.17 mm.
# Safety against a guide that is tilted (U).
TILT_LIMIT_DEG = 0.1
# An arm of the usual repeatability, 0.015 mm per axis, is off by 0.05 mm in 1 approach of 100. The mean of
# three, including changer, dials and the record of twelve, is that far off in 4 of 1,000; then three more are
# read.
APPROACHES = 3
DIALS = ("x", "y", "z", "upper x", "upper y")


class CheckedTool(StepResult, kind="tool_check"):
    """Comparison of the mounted guide with its record."""

    tool_record: str = Field(description="Identifier of the record it was compared with.")
    readings_mm: tuple[tuple[float, ...], ...] = Field(
        description="Dial readings in each approach: x, y and z at the end, x and y higher up."
    )
    offset_mm: Numbers3 = Field(description="Offset of the mandrel's end from the record, tip frame.")
    off_mm: float = Field(description="Length of that offset.")
    tilt_deg: float = Field(description="Tilt of the mandrel from the record.")
    joints_rad: JointVector = Field(description="Measured joints at the gauge.")
    seen_off_mm: float | None = Field(
        default=None,
        description="Its distance from the record as seen by the tracker; none without a frame on it.",
    )


def run(context: StepContext) -> Outcome[CheckedTool]:
    """Check the guide. If it differs and the operator agrees, check it once more after remounting.

    Raises TOOL-005 to TOOL-007, PRO-002, PRO-009.
    """
    try:
        return _check_tool(context)
    except ToolBesideGauge as problem:
        context.find(problem.summary)
        doubt(context, problem.summary, again=False)  # targets that it served before a restart or a fault
        tip = context.workcell.calibrations.tool_tip
        question = TOOL_BESIDE_GAUGE.question(
            "The guide differs from its record. Is it mounted again?",
            f"{problem.summary}; {YES}: guide and mandrel have been seated anew, check once more; {NO}: the "
            "step ends",
        )
        context.setting.room.change_tool(tip.tool_number, "the surgical guide")
        if context.choose(question) != YES:
            raise
    return _check_tool(context)


def _check_tool(context: StepContext) -> Outcome[CheckedTool]:
    """Check head, base and any frame on the guide by tracker, then the guide on the gauge.

    Raises TOOL-005 to TOOL-007, PRO-002.
    """
    workcell = context.workcell
    context.result(MountedGuide)
    context.request_instrument_removal()  # of an earlier attempt
    workcell.master.mount.check(MountedTool.GUIDE)
    look = check_room(context, "before the guide is checked", CAREFUL_FRAMES)
    frame = workcell.tools.guide.record.frame
    seen_off_mm = None if frame is None else require_seen_in_place(context, frame, look)
    found = read_on_gauge(context)
    if found.differs:
        workcell.rest()  # hands reseat it: nothing may move the arm meanwhile
        raise ToolBesideGauge(
            "the guide is not as it was when its tip was calibrated",
            limit=f"{found.noticeable_mm:g} mm, {TILT_LIMIT_DEG:g} deg",
            got=f"{found.off_mm:.3f} mm, {found.tilt_deg:.3f} deg (x, y, z: "
            + ", ".join(f"{value:+.3f}" for value in found.offset_mm)
            + ")",
        )
    identifier = workcell.tools.guide.record.identifier
    return Outcome(
        CheckedTool(
            tool_record=identifier,
            readings_mm=found.readings_mm,
            offset_mm=found.offset_mm,
            off_mm=found.off_mm,
            tilt_deg=found.tilt_deg,
            joints_rad=found.joints_rad,
            seen_off_mm=seen_off_mm,
        ),
        summary=f"the guide is {found.off_mm:.3f} mm and {found.tilt_deg:.3f} deg from its record "
        f"({identifier})",
    )


@dataclass(frozen=True)
class GuideOnGauge:
    """Gauge reading of the guide, compared with its record."""

    readings_mm: tuple[tuple[float, ...], ...]
    offset_mm: Numbers3
    tilt_deg: float
    joints_rad: JointVector
    noticeable_mm: float

    @property
    def off_mm(self) -> float:
        """Magnitude of the offset (mm)."""
        return math.hypot(*self.offset_mm)

    @property
    def differs(self) -> bool:
        """Whether the guide is noticeably off its calibrated pose: bent or badly seated."""
        return self.off_mm > self.noticeable_mm or self.tilt_deg > TILT_LIMIT_DEG


def read_on_gauge(context: StepContext) -> GuideOnGauge:
    """Read the mandrel in the gauge three times, then go home.

    If the mean differs from the record, three more readings are taken and the mean of six decides. Raises
    PRO-002, TOOL-007 and the errors of the motions.
    """
    workcell = context.workcell
    guide = workcell.tools.guide
    robot_from_ct = context.result(Correspondence).robot_from_ct.transform
    tip = workcell.master.flange_from(MountedTool.GUIDE)
    gauge_rad = radians6(*guide.gauge.joints_deg)
    workcell.master.surround(planning_scene_of(context).with_guide(robot_from_ct, tip, None), gauge_rad)
    workcell.start()
    there = [workcell.master.settle_motion(gauge_rad, ONE_SIDE, allow_detour=True)]
    workcell.master.supervised.confirm(
        Topic.TOOL_CHECK, "Move the guide over to the gauge on the table?", there
    )
    noticeable_mm = guide_noticeable_mm(workcell.master.arm.kinematics.name)
    reads = tuple(f"dial {name} of the gauge in mm" for name in DIALS)
    task = Task(
        GAUGE,
        "put the mandrel into the guide and the gauge, and read the dials",
        numbers=(*guide.gauge.joints_deg, guide.gauge.base_mm),
        reads=reads,
        plausible_mm=guide.gauge.plausible_mm,
    )
    readings: list[tuple[float, ...]] = []
    for number in range(2 * APPROACHES):
        context.progress((1 + number) / (2 + 2 * APPROACHES), "moving to the gauge")
        reached = workcell.master.settle(gauge_rad, ONE_SIDE, allow_detour=number == 0)
        workcell.master.hold()  # a hand pushes the mandrel in: only the next motion may move the arm
        workcell.master.instrument.record_insertion(IN_GAUGE)
        seatings = APPROACHES if number < APPROACHES else 2 * APPROACHES
        seating = f"{task.subject} (seating {1 + number} of {seatings})"
        readings.append(context.perform_task(replace(task, subject=seating)))
        if number == 0:
            read_s = context.setting.clock.now_s()
        context.request_instrument_removal()
        found = GuideOnGauge(
            tuple(readings), *compare_with_record(guide.gauge, readings), reached.joints_rad, noticeable_mm
        )
        if number + 1 == APPROACHES and not found.differs:
            break
    workcell.start()  # the arm may have been recovered while hands were at the gauge
    workcell.master.park("from the gauge")
    require_recent(context, "the dials of the gauge", read_s)
    return found


def compare_with_record(gauge: Gauge, readings_mm: Sequence[Sequence[float]]) -> tuple[Numbers3, float]:
    """Return the mandrel end's offset (mm) and tilt (deg) from the record for the mean reading."""
    recorded_mm = (*gauge.reading_mm, *gauge.upper_reading_mm)
    read_mm = np.mean(readings_mm, axis=0)
    x, y, z, upper_x, upper_y = np.subtract(read_mm, recorded_mm).tolist()
    tilt_rad = math.atan2(math.hypot(upper_x - x, upper_y - y), gauge.base_mm)
    return (x, y, z), math.degrees(tilt_rad)


STEP = StepSpec(
    CheckedTool,
    "Check the guide on the gauge",
    Phase.OPERATION,
    run,
    asks=(Topic.TOOL_CHECK, Topic.INSTRUMENT_OUT, Topic.PARK),
    reads=(MountedGuide, *ROOM_READS, *READS),
    moves=True,
    rechecks=True,
    preconditions=needs_tool(MountedTool.GUIDE),
)
