"""A session in which monitor, silence or the parent's heart stops the arm."""

from __future__ import annotations

from math import radians

import pytest
from session_cell import (
    FAR,
    MODEL,
    RAMP_DOWN_SHARE,
    SETTINGS,
    START,
    Cell,
    begun,
    fault_of,
    moving,
)

from drivers.kuka_rsi.realtime.link_state import (
    CommandKind,
    Fault,
    Orders,
    Phase,
)
from ronna_hw.arm.angles import radians6
from ronna_hw.arm.monitor import FOLLOWING_TIME_S
from ronna_hw.arm.motion.planning import MotionPlan
from ronna_hw.arm.motion.progress import PathLimits
from ronna_hw.arm.pose import Pose

CYCLE_S = SETTINGS.cycle_ms / 1000.0
LONGEST_STOP_S = 0.5  # of a path stop, as the table of disturbances promises
MOST_CYCLES = 1000


@pytest.mark.parametrize(
    ("limits", "kind"),
    [
        (PathLimits(5.0, 5.0, 20.0), "step"),
        (PathLimits(1.0, 10.0, 100.0), "acceleration"),
        (PathLimits(0.5, 50.0, 5000.0), "jerk"),
    ],
)
def test_a_generator_that_asks_too_much_is_stopped_by_the_monitor(limits: PathLimits, kind: str) -> None:
    cell = begun()
    cell.give(CommandKind.MOVE, MotionPlan(START, FAR, limits))
    for _ in range(400):
        cell.cycle()
    assert cell.session.fault is Fault.MONITOR
    assert cell.session.violation is not None
    assert cell.session.violation.kind == kind
    assert not cell.session.moving
    assert cell.session.phase is Phase.FAULT
    assert cell.smooth(RAMP_DOWN_SHARE)


def test_a_path_that_leads_out_of_range_is_stopped_at_the_range() -> None:
    beyond = radians6(0, -90, 90, 0, 125, 0)
    cell = begun()
    cell.give(CommandKind.MOVE, MotionPlan(START, beyond, PathLimits(0.3, 1.0, 10.0)))
    for _ in range(1500):
        cell.cycle()
    assert cell.session.fault is Fault.MONITOR
    assert cell.session.violation is not None
    assert cell.session.violation.kind == "range"
    assert cell.session.sent_rad[4] <= MODEL.upper_rad[4] + radians(2.0)
    assert cell.smooth()


def test_a_line_without_a_solution_on_the_way_is_stopped_by_the_joints() -> None:
    here = MODEL.forward(START)
    away = Pose((here.position_mm[0] + 900, here.position_mm[1], here.position_mm[2]), here.rotation)
    cell = begun()
    cell.give(CommandKind.MOVE, MotionPlan(START, (*START[:5], 0.1), PathLimits(0.1, 0.1, 1.0), away))
    for _ in range(3000):
        cell.cycle()
        if cell.session.fault and not cell.session.moving:
            break
    assert cell.session.fault in (Fault.PATH, Fault.MONITOR)
    assert not cell.session.moving
    assert cell.smooth(RAMP_DOWN_SHARE)


@pytest.mark.hazard(38)
def test_an_axis_that_does_not_follow_stops_the_arm() -> None:
    cell = moving(cycles=150, target=(START[0] + radians(60), *START[1:]))  # one axis, at its working speed
    cell.follows = False
    cycles = _until_fault(cell)
    assert cell.session.fault is Fault.MONITOR
    assert cell.session.violation is not None
    assert cell.session.violation.kind == "following error"
    assert cycles == pytest.approx(FOLLOWING_TIME_S / CYCLE_S, abs=3)
    assert _rests_within(cell, LONGEST_STOP_S)
    assert cell.smooth()


def test_silence_beyond_the_limit_is_latched_and_the_motion_forgotten() -> None:
    cell = moving()
    orders = Orders(cell.beat, 0, cell.commands)
    cell.session.idle(orders, cell.now_ns + 240_000_000)
    assert fault_of(cell) is Fault.NONE
    cell.session.idle(orders, cell.now_ns + 260_000_000)
    assert cell.session.fault is Fault.SILENCE
    assert not cell.session.moving
    before = cell.sent[-1][0]
    cell.cycle(lost=70)
    assert cell.sent[-1][0] == before


@pytest.mark.hazard(30)
def test_a_late_heartbeat_stops_the_arm_and_ends_the_program() -> None:
    cell = moving(cycles=1)
    cell.beats = False
    cycles = _until_fault(cell)
    assert cell.session.fault is Fault.HEARTBEAT
    assert cycles == pytest.approx(SETTINGS.heartbeat_limit_s / CYCLE_S, abs=2)
    assert _rests_within(cell, LONGEST_STOP_S)
    cell.cycle()
    assert cell.session.phase is Phase.ENDING
    assert cell.sent[-1][1] == 1
    assert cell.smooth()


def test_a_heart_that_beats_now_and_then_keeps_the_session() -> None:
    cell = begun()
    for k in range(1000):
        cell.beats = k % 200 == 0
        cell.cycle()
    assert cell.session.fault is Fault.NONE


@pytest.mark.hazard(30)
def test_without_its_parent_the_arm_stops_and_the_program_is_ended() -> None:
    cell = moving()
    cell.session.parent_gone = True
    assert _rests_within(cell, LONGEST_STOP_S)
    cell.cycle()
    assert cell.session.phase is Phase.ENDING
    assert cell.sent[-1][1] == 1
    assert cell.smooth()


def _until_fault(cell: Cell) -> int:
    """Cycles until a fault is latched."""
    for cycles in range(1, MOST_CYCLES):
        cell.cycle()
        if cell.session.fault:
            return cycles
    raise AssertionError("no fault")


def _rests_within(cell: Cell, limit_s: float) -> bool:
    """Whether the set-points come to rest in that time."""
    for _ in range(round(limit_s / CYCLE_S)):
        cell.cycle()
        if not cell.session.moving:
            return True
    return False
