"""Sessions in which the monitor, losses, silence or a missing heartbeat stop the arm."""

from __future__ import annotations

from dataclasses import replace
from math import radians

import pytest
from rsi_stand import (
    FAR,
    LIMITS,
    MODEL,
    RAMP_DOWN_SHARE,
    SETTINGS,
    START,
    RsiStand,
    begun,
    moving,
)

from drivers.kuka_rsi.realtime.link_health import Losses
from ronna_hw.arm.clearance.live_watch import Violation, ViolationKind
from ronna_hw.arm.monitor import FOLLOWING_RAD, FOLLOWING_TIME_S
from ronna_hw.arm.motion.planning import MotionPlan, plan_joint_move
from ronna_hw.arm.motion.progress import PathLimits
from ronna_hw.arm.pose import Pose, radians6
from ronna_hw.arm_stream.records import (
    STOP_KIND_BITS,
    LinkFault,
    LinkState,
    MotionResult,
    Move,
    Orders,
    StreamPhase,
)
from ronna_hw.arm_stream.session import SETTLE_CYCLES

CYCLE_S = SETTINGS.cycle_ms / 1000.0
LONGEST_STOP_S = 0.5  # of a path stop, as the table of disturbances promises
MOST_CYCLES = 1000


@pytest.mark.parametrize(
    ("limits", "kind"),
    [
        (PathLimits(5.0, 5.0, 20.0), "speed"),
        (PathLimits(1.0, 10.0, 100.0), "acceleration"),
        (PathLimits(0.5, 50.0, 5000.0), "jerk"),
    ],
)
def test_the_monitor_stops_a_generator_that_exceeds_a_limit(limits: PathLimits, kind: str) -> None:
    stand = begun()
    stand.give(Move(MotionPlan(START, FAR, limits)))
    stand.cycles(400)
    assert stand.session.fault is LinkFault.MONITOR
    assert stand.violation_kind == kind
    assert not stand.session.moving
    assert stand.session.phase is StreamPhase.FAULT
    assert stand.smooth(RAMP_DOWN_SHARE)


@pytest.mark.hazard(51)
def test_at_reduced_speed_the_process_holds_an_axis_to_a_tenth_of_its_full_speed() -> None:
    """A motion planned at full working speed, as if planning had missed that the controller is in T1."""
    wrist_turned = radians6(0, -90, 90, 40, 60, 60)
    stand = RsiStand(limits=LIMITS.with_reduced_speed(MODEL))
    stand.cycles(3)
    stand.give(Move(plan_joint_move(MODEL, START, wrist_turned, LIMITS)))
    stand.cycles(400)
    violation = stand.session.violation
    assert violation is not None
    assert violation.kind == "speed"
    assert violation.limit == pytest.approx(0.1 * MODEL.full_speed_rad_s[violation.axis - 1])
    assert stand.smooth(RAMP_DOWN_SHARE)


@pytest.mark.hazard(51)
@pytest.mark.parametrize("margin_deg", [0.5, 30.0])
def test_the_process_keeps_the_margin_of_the_theatre_file(margin_deg: float) -> None:
    stand = RsiStand(limits=replace(LIMITS, range_margin_rad=radians(margin_deg)))
    stand.cycles(3)
    beyond = radians6(0, -90, 90, 0, 120.0 - margin_deg + 0.5, 0)
    stand.give(Move(MotionPlan(START, beyond, PathLimits(0.3, 1.0, 10.0))))
    stand.cycles(1500)
    assert stand.violation_kind == "range"
    assert stand.session.violation.limit == pytest.approx(radians(120.0 - margin_deg))


def test_a_line_without_a_joint_solution_on_the_way_is_stopped() -> None:
    here = MODEL.forward(START)
    away = Pose((here.position_mm[0] + 900, here.position_mm[1], here.position_mm[2]), here.rotation)
    stand = begun()
    stand.give(Move(MotionPlan(START, (*START[:5], 0.1), PathLimits(0.1, 0.1, 1.0), away)))
    for _ in range(3000):
        stand.cycle()
        if stand.session.fault and not stand.session.moving:
            break
    assert stand.session.fault in (LinkFault.PATH, LinkFault.MONITOR)
    assert not stand.session.moving
    assert stand.smooth(RAMP_DOWN_SHARE)


@pytest.mark.hazard(38)
@pytest.mark.parametrize("share_per_s", [0.5, 0.02])
def test_an_axis_that_does_not_follow_stops_the_arm_at_every_speed(share_per_s: float) -> None:
    target = (START[0] + radians(40), *START[1:])
    stand = begun()
    stand.give(Move(MotionPlan(START, target, PathLimits(share_per_s, 2.0, 20.0))))
    stand.cycles(100)
    before = stand.session.sent_rad[0]
    stand.follows = False
    cycles = _until_fault(stand)
    assert stand.session.fault is LinkFault.MONITOR
    assert stand.violation_kind == "following error"
    left = [radians(sent[0]) + START[0] - before for sent, _ in stand.sent[-cycles:]]
    # The first set-point that the axis should have reached by now, but did not.
    due = next(cycle for cycle, angle in enumerate(left) if angle > FOLLOWING_RAD)
    assert cycles == pytest.approx(due + FOLLOWING_TIME_S / CYCLE_S, abs=3)
    assert _rests_within(stand, LONGEST_STOP_S)
    assert stand.smooth()


@pytest.mark.hazard(38)
def test_an_arm_clamped_near_its_target_is_stopped_instead_of_waited_for() -> None:
    stand = moving(cycles=1, target=(START[0] + radians(2.0), *START[1:]))
    stand.clamp_deg = 1.0
    cycles = _until_fault(stand)
    assert stand.violation_kind == "following error"
    assert cycles * CYCLE_S < 2.0


@pytest.mark.parametrize(
    ("foreign", "fault"),
    [(False, LinkFault.SILENCE), pytest.param(True, LinkFault.RESTARTED, marks=pytest.mark.hazard(34))],
)
def test_silence_beyond_the_limit_latches_a_fault_and_discards_the_motion(
    foreign: bool, fault: LinkFault
) -> None:
    stand = moving()
    orders = Orders(stand.beat, 0, stand.commands)
    if foreign:  # a controller that restarts its program sends from another port
        stand.session.senders.count_foreign("10.0.0.3")
    stand.session.monitor_silence(orders, stand.now_ns + 240_000_000)
    assert stand.session.fault is LinkFault.NONE
    stand.session.monitor_silence(orders, stand.now_ns + 260_000_000)
    assert stand.session.fault is fault
    assert not stand.session.moving
    before = stand.sent[-1][0]
    stand.cycle(lost=70)
    assert stand.sent[-1][0] == before


@pytest.mark.hazard(30)
def test_a_missing_heartbeat_stops_the_arm_and_ends_the_program() -> None:
    stand = moving(cycles=1)
    stand.beats = False
    cycles = _until_fault(stand)
    assert stand.session.fault is LinkFault.HEARTBEAT
    assert cycles == pytest.approx(SETTINGS.heartbeat_limit_s / CYCLE_S, abs=2)
    assert _ends_smoothly(stand)


@pytest.mark.hazard(30)
def test_losing_the_parent_process_stops_the_arm_and_ends_the_program() -> None:
    stand = moving()
    stand.session.is_parent_gone = True
    assert _ends_smoothly(stand)


def _until_fault(stand: RsiStand) -> int:
    """Run cycles until a fault is latched."""
    for cycles in range(1, MOST_CYCLES):
        stand.cycle()
        if stand.session.fault:
            return cycles
    raise AssertionError("no fault")


def _ends_smoothly(stand: RsiStand) -> bool:
    """Test whether the arm comes to rest and the program is ended."""
    rests = _rests_within(stand, LONGEST_STOP_S)
    stand.cycle()
    return rests and stand.session.phase is StreamPhase.ENDING and stand.sent[-1][1] == 1 and stand.smooth()


def _rests_within(stand: RsiStand, limit_s: float) -> bool:
    """Test whether the set-points come to rest in that time."""
    for _ in range(round(limit_s / CYCLE_S)):
        stand.cycle()
        if not stand.session.moving:
            return True
    return False


def test_more_than_three_lost_cycles_degrade_the_link_until_a_clean_second_has_passed() -> None:
    losses = Losses(4)
    ipoc = 0
    for k in range(4):
        assert not losses.degraded
        ipoc += 8
        assert losses.count(ipoc, k) == (1 if k else 0)
    ipoc += 8
    losses.count(ipoc, 4)
    assert losses.degraded
    assert losses.lost == 4
    for _ in range(1000):
        ipoc += 4
        losses.count(ipoc, 4)
    assert not losses.degraded


def test_the_time_stamp_may_wrap_and_repeat_but_not_run_backwards() -> None:
    losses = Losses(4)
    assert losses.count(2**32 - 4, -1) == 0
    assert losses.count(0, -1) == 0
    assert losses.count(0, -1) == -1
    assert losses.count(8, -1) == 1
    assert losses.count(4, -1) == -1  # overtaken on the way
    assert losses.count(12, -1) == 0
    assert losses.count(60_000, -1) is None
    assert losses.count(2**32 - 4000, -1) is None
    for stale in (8, 4, 8):
        assert losses.count(stale, -1) == -1
    assert losses.count(8, -1) is None  # and again and again: that is no accident


@pytest.mark.hazard(18)
def test_overtaken_and_repeated_telegrams_get_no_reply_and_do_not_disturb_the_motion() -> None:
    stand = moving()
    for back in (4, 8, 12):
        stand.ipoc -= back
        assert not stand.cycle()
        stand.ipoc += back - 4
        assert stand.cycle()
    stand.run()
    assert stand.session.result is MotionResult.DONE
    assert stand.session.fault is LinkFault.NONE
    assert stand.smooth()


@pytest.mark.hazard(18)
@pytest.mark.parametrize("stall_ms", [8, 20, 50, 100, 250, 400, 500])
def test_a_motion_continues_smoothly_after_a_host_stall_and_arrives(stall_ms: int) -> None:
    stand = moving()
    assert stand.cycle(lost=stall_ms // 4)
    stand.run()
    assert stand.session.result is MotionResult.DONE
    assert stand.session.fault is LinkFault.NONE
    assert stand.smooth()
    state = stand.session.state(real_time=False, locked=False)
    assert state.lost == stall_ms // 4


@pytest.mark.hazard(34)
def test_telegrams_of_another_run_get_no_reply_and_latch_a_fault() -> None:
    stand = moving()
    stand.ipoc = 12
    assert not stand.cycle()
    assert stand.session.fault is LinkFault.RESTARTED
    assert not stand.cycle()


def test_a_stranger_among_the_telegrams_does_not_disturb_the_motion() -> None:
    stand = moving()
    stand.session.senders.count_foreign("10.0.0.3")
    stand.run()
    assert stand.session.result is MotionResult.DONE
    state = stand.session.state(real_time=False, locked=False)
    assert (state.foreign, state.foreign_host) == (1, "10.0.0.3")


@pytest.mark.parametrize("told", ["degraded", "moving", "settled", "real_time", "locked", "carries_loads"])
def test_the_state_reports_each_field_under_its_name(told: str) -> None:
    """No two fields of one type have the same value; of the six flags one at a time is true."""
    stand = moving() if told == "moving" else begun()
    session = stand.session
    session.cycles, session.device_clock, session._received_ns = 11, 12, 13
    session.phase, session.fault, session.result = (
        StreamPhase.ENDING,
        LinkFault.BASE,
        MotionResult.REFUSED_START,
    )
    session._losses.degraded = told == "degraded"
    session._settled_cycles = SETTLE_CYCLES if told == "settled" else SETTLE_CYCLES - 1
    session._command_number, session._stop_word = 14, 15 << STOP_KIND_BITS
    session._losses.late, session._losses.lost = 16, 17
    session.rejected, session.dropped = 18, 19
    session.senders.count, session.senders.host, session.senders.disagreeing = 20, "10.0.0.3", 21
    session._measured, session._base_rad = FAR, (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    session.violation = Violation(ViolationKind.JERK, 5, 0.7, 0.8)
    session._speed, session.controller_word = 0.9, 22
    session._currents = b' A1=""' if told == "carries_loads" else b""
    assert session.sent_rad not in (FAR, session._base_rad)
    assert session.state(real_time=told == "real_time", locked=told == "locked") == LinkState(
        **{told: True},
        cycles=11,
        device_clock=12,
        received_ns=13,
        phase=StreamPhase.ENDING,
        fault=LinkFault.BASE,
        result=MotionResult.REFUSED_START,
        command_number=14,
        stop_number=15,
        late=16,
        lost=17,
        rejected=18,
        dropped=19,
        foreign=20,
        foreign_host="10.0.0.3",
        disagreeing=21,
        measured_rad=FAR,
        commanded_rad=session.sent_rad,
        base_rad=(0.1, 0.2, 0.3, 0.4, 0.5, 0.6),
        violation_kind=ViolationKind.JERK,
        violation_axis=5,
        violation_value=0.7,
        violation_limit=0.8,
        speed_share=0.9,
        controller_word=22,
    )
