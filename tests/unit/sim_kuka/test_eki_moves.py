"""PTP and LIN motions of the EKI program: goal, speed, interruption and refusals."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from math import dist
from typing import Any

import numpy as np
import pytest

from ronna_hw.wire.kuka_eki import AXIS_ATTRIBUTES, AckCode, OperationMode, ProState
from sim.kuka.eki.moves import EkiMoves
from sim.kuka.motion import Acknowledgement, path_parameters
from sim.world.nominal_arm import axes_of_posture, description, frame_of, status_and_turn
from sim.world.true_arm import JointChain

HOME_DEG = (0.0, -90.0, 90.0, 0.0, 90.0, 0.0)
GOAL_DEG = (20.0, -80.0, 100.0, 30.0, 60.0, -40.0)
FRAME = ("X", "Y", "Z", "A", "B", "C")


class Program:
    """The EKI program of a bench, and what it was told."""

    def __init__(self, bench: Any) -> None:
        self.controller = bench.controller
        self.ends: list[Acknowledgement] = []
        self.moves = EkiMoves(self.controller, self.ends.append)
        self.axes: list[list[float]] = []
        self.places: list[list[float]] = []

    def ptp(self, axes_deg: tuple[float, ...] = GOAL_DEG, **more: object) -> Acknowledgement:
        given = {f"A{n}": str(angle) for n, angle in enumerate(axes_deg, 1)}
        return self.moves.ptp_axis({**given, **{key: str(value) for key, value in more.items()}})

    def to_pose(self, kind: str, frame: list[float], **more: object) -> Acknowledgement:
        given = {name: repr(value) for name, value in zip(FRAME, frame, strict=True)}
        attributes = {**given, **{key: str(value) for key, value in more.items()}}
        return self.moves.lin(attributes) if kind == "LIN" else self.moves.ptp_pos(attributes)

    def cycles(self, count: int) -> None:
        for _ in range(count):
            self.controller.settle()
            self.axes.append(self.controller.arm.axes_deg)
            self.places.append(self.controller.arm.frame)

    def finish(self, limit: int = 5000) -> AckCode:
        for _ in range(limit):
            self.cycles(1)
            if self.ends and not self.controller.moving:
                return self.ends[-1].code
        raise AssertionError("the motion does not end")


@pytest.fixture
def program(make_bench: Callable[..., Any]) -> Program:
    program = Program(make_bench(start=False))
    program.controller.switch_drives(True)
    return program


@pytest.mark.parametrize("variant", ["kr6_r900_sixx", "kr6_r900_2"])
def test_status_and_turn_recover_the_axes_they_were_computed_from(variant: str) -> None:
    arm, generator = description(variant), np.random.default_rng(8)
    chain = JointChain(arm)
    for _ in range(2000):
        axes_deg = [generator.uniform(joint.lower_deg, joint.upper_deg) for joint in arm.joints]
        status, turn = status_and_turn(arm, axes_deg)
        found = axes_of_posture(arm, chain.flange(np.radians(axes_deg)), status, turn, axes_deg)
        assert found is not None
        assert np.allclose(found, axes_deg, atol=1e-6)


def test_a_straight_wrist_keeps_a4_where_it_is() -> None:
    arm = description("kr6_r900_sixx")
    axes_deg = [10.0, -80.0, 100.0, 35.0, 0.0, 20.0]
    flange = JointChain(arm).flange(np.radians(axes_deg))
    found = axes_of_posture(arm, flange, *status_and_turn(arm, axes_deg), near_deg=axes_deg)
    assert found is not None
    assert np.allclose(found, axes_deg, atol=1e-6)


def test_a_pose_out_of_reach_or_beyond_an_end_switch_has_no_posture() -> None:
    arm = description("kr6_r900_sixx")
    flange = JointChain(arm).flange(np.radians(GOAL_DEG))
    status, turn = status_and_turn(arm, GOAL_DEG)
    far = flange.copy()
    far[0, 3] += 2000.0
    assert axes_of_posture(arm, far, status, turn, GOAL_DEG) is None
    assert axes_of_posture(arm, flange, status, turn ^ 2, GOAL_DEG) is None  # A2 at +280 deg


def test_a_profile_begins_and_ends_at_rest_within_its_limits() -> None:
    for speed, acceleration in ((0.5, 1.0), (3.0, 1.0)):  # with and without a part at constant speed
        way = np.array([0.0, 0.0, *path_parameters(speed, acceleration, 0.004), 1.0])
        assert way[-1] == 1.0
        assert np.diff(way).min() >= 0.0
        assert np.diff(way).max() <= min(speed, acceleration**0.5) * 0.004 * 1.01
        assert np.abs(np.diff(way, 2)).max() <= acceleration * 0.004**2 * 1.6  # the last step is rounded


def test_a_ptp_arrives_exactly_and_is_acknowledged_on_acceptance_and_on_completion(program: Program) -> None:
    assert program.ptp(Vel=50, Acc=50) == Acknowledgement(AckCode.OK, "accepted")
    assert program.controller.program_state is ProState.ACTIVE
    assert not program.ends
    assert program.ptp().code is AckCode.BUSY  # while the first one runs
    assert program.finish() is AckCode.OK
    assert program.controller.arm.axes_deg == list(GOAL_DEG)
    assert len(program.ends) == 1
    assert program.ptp(HOME_DEG).code is AckCode.OK
    assert program.finish() is AckCode.OK


def test_a_ptp_scales_the_axis_speed_by_vel_and_override(program: Program) -> None:
    program.controller.set_override(50)
    program.ptp((160.0, *HOME_DEG[1:]), Vel=40)
    program.finish()
    fastest_deg_s = max(abs(b[0] - a[0]) for a, b in pairwise(program.axes)) / 0.004
    assert fastest_deg_s == pytest.approx(0.2 * 360.0, rel=0.01)


def test_a_pose_is_reached_in_the_requested_posture(program: Program) -> None:
    arm = description("kr6_r900_sixx")
    frame = frame_of(JointChain(arm).flange(np.radians(GOAL_DEG)))
    status, turn = status_and_turn(arm, GOAL_DEG)
    assert program.to_pose("PTP_POS", frame, S=status, T=turn).code is AckCode.OK
    assert program.finish() is AckCode.OK
    assert program.controller.arm.axes_deg == pytest.approx(GOAL_DEG, abs=1e-6)
    turned = program.to_pose("PTP_POS", frame, S=status ^ 4, T=turn ^ 0b111000)
    assert turned.code is AckCode.OK
    assert program.finish() is AckCode.OK
    assert program.controller.arm.axes_deg[4] == pytest.approx(-GOAL_DEG[4], abs=1e-6)
    assert program.controller.arm.frame == pytest.approx(frame, abs=1e-6)


def test_a_pose_refers_to_the_named_tool_and_base(program: Program) -> None:
    controller = program.controller
    controller.set_tool(3, (0.0, 0.0, 150.0, 0.0, 0.0, 0.0))
    controller.set_base(5, (100.0, 50.0, 0.0, 90.0, 0.0, 0.0))
    here = controller.arm.frame
    goal = [here[0] - 10.0, *here[1:]]  # to the right: A1 and A6 stay positive
    status, turn = status_and_turn(controller.arm.description, controller.arm.axes_deg)
    with pytest.raises(ValueError, match="tool 4 is not defined"):
        program.to_pose("PTP_POS", goal, S=status, T=turn, Tool=4)
    assert program.to_pose("PTP_POS", goal, S=status, T=turn, Tool=3, Base=5).code is AckCode.OK
    assert program.finish() is AckCode.OK
    assert controller.arm.frame == pytest.approx(goal, abs=1e-6)
    assert (controller.arm.tool_number, controller.arm.base_number) == (3, 5)


def test_a_line_is_straight_and_runs_at_the_requested_speed(program: Program) -> None:
    begin = list(program.controller.arm.frame)
    goal = [begin[0] + 60.0, begin[1] + 80.0, begin[2], *begin[3:]]
    assert program.to_pose("LIN", goal, Vel=0.1).code is AckCode.OK
    assert program.finish() is AckCode.OK
    assert program.controller.arm.frame[:3] == pytest.approx(goal[:3], abs=1e-3)
    places = np.array(program.places)[:, :3] - begin[:3]
    direction = np.array([0.6, 0.8, 0.0])
    assert np.linalg.norm(np.cross(places, direction), axis=1).max() < 0.05  # the lag bends it a little
    speeds = [dist(a[:3], b[:3]) / 0.004 for a, b in pairwise(program.places)]
    assert max(speeds) == pytest.approx(100.0, rel=0.02)


def test_a_line_can_turn_the_tool_in_place(program: Program) -> None:
    begin = list(program.controller.arm.frame)
    goal = [*begin[:3], begin[3] - 20.0, begin[4], begin[5]]
    assert program.to_pose("LIN", goal, Vel=0.1).code is AckCode.OK
    assert program.finish() is AckCode.OK
    assert program.controller.arm.frame[:3] == pytest.approx(begin[:3], abs=1e-3)
    assert program.controller.arm.axes_deg[5] - HOME_DEG[5] == pytest.approx(-20.0, abs=1e-3) or (
        program.controller.arm.axes_deg[5] - HOME_DEG[5] == pytest.approx(20.0, abs=1e-3)
    )


def test_a_line_through_the_straight_wrist_is_stopped_or_refused_without_a_jump(program: Program) -> None:
    program.ptp((0.0, -80.0, 100.0, 20.0, 8.0, 0.0))
    program.finish()
    program.axes.clear()
    arm = description("kr6_r900_sixx")
    across = frame_of(JointChain(arm).flange(np.radians((0.0, -80.0, 100.0, 20.0, -8.0, 0.0))))
    answer = program.to_pose("LIN", across, Vel=0.5)
    if answer.code is AckCode.OK:
        assert program.finish() is AckCode.ABORTED
        assert program.controller.message is not None
        assert program.controller.message.number == 1102
    else:
        assert answer.code is AckCode.LIMIT
    steps = [max(abs(b - a) for a, b in zip(*pair, strict=True)) for pair in pairwise(program.axes)]
    assert max(steps, default=0.0) < 615.0 * 0.004


def test_a_fast_stop_is_shorter(make_bench: Callable[..., Any]) -> None:
    ways = []
    for fast in (False, True):
        program = Program(make_bench(start=False))
        program.controller.switch_drives(True)
        program.ptp((120.0, *HOME_DEG[1:]))
        program.cycles(60)
        begun = program.controller.arm.axes_deg[0]
        program.controller.stop(fast=fast)
        program.finish()
        ways.append(program.controller.arm.axes_deg[0] - begun)
    assert ways[1] == pytest.approx(ways[0] / 2, rel=0.1)


@pytest.mark.parametrize(
    ("event", "state"),
    [
        (lambda c: c.press_emergency_stop(True), ProState.STOP),
        (lambda c: c.switch_drives(False), ProState.END),
        (lambda c: c.cancel(), ProState.FREE),
        (lambda c: c.stop(), ProState.END),
        (lambda c: c.turn_key(OperationMode.T1), ProState.END),
        (lambda c: c.collide(), ProState.STOP),
    ],
)
def test_an_interrupted_motion_is_reported_as_aborted(
    program: Program, event: Callable[[Any], object], state: ProState
) -> None:
    program.ptp()
    program.cycles(40)
    event(program.controller)
    assert program.finish() is AckCode.ABORTED
    assert len(program.ends) == 1
    assert program.controller.program_state is state


def test_impossible_or_incomplete_motions_are_refused_before_anything_moves(
    program: Program, bench: Any
) -> None:
    with pytest.raises(ValueError, match="A2"):
        program.moves.ptp_axis({"A1": "1"})
    with pytest.raises(ValueError, match="Vel"):
        program.ptp(Vel=0)
    with pytest.raises(ValueError, match="S is missing"):
        program.to_pose("PTP_POS", [400.0, 0.0, 800.0, 180.0, 0.0, 180.0])
    with pytest.raises(ValueError, match="Vel is missing"):
        program.to_pose("LIN", [400.0, 0.0, 800.0, 180.0, 0.0, 180.0])
    assert program.ptp((171.0, *HOME_DEG[1:])).code is AckCode.LIMIT
    assert program.to_pose("PTP_POS", [4000.0, 0.0, 0.0, 0.0, 0.0, 0.0], S=2, T=2).code is AckCode.LIMIT
    assert program.to_pose("LIN", [4000.0, 0.0, 0.0, 0.0, 0.0, 0.0], Vel=0.1).code is AckCode.LIMIT
    program.controller.switch_drives(False)
    assert program.ptp().code is AckCode.NOT_READY
    assert not program.controller.moving
    running = Program(bench)
    assert running.ptp().code is AckCode.BUSY  # RSI is running


@pytest.mark.parametrize("value", ["-1e308", "1e300", "1000001", "inf", "nan", "1e400"])
def test_a_number_that_nothing_can_be_calculated_with_is_refused(program: Program, value: str) -> None:
    given = {**dict.fromkeys(FRAME, "0"), "X": value, "S": "2", "T": "2", "Vel": "0.1"}
    for command in (program.moves.ptp_pos, program.moves.lin):
        with pytest.raises(ValueError, match="X is missing or not a number up to 1e\\+06"):
            command(given)


@pytest.mark.parametrize(("command", "name"), [("ptp_axis", "Vel"), ("ptp_axis", "Acc"), ("lin", "Vel")])
def test_a_motion_without_an_end_is_refused(program: Program, command: str, name: str) -> None:
    given = {**dict.fromkeys((*FRAME, *AXIS_ATTRIBUTES), "0"), name: "1e-310"}
    with pytest.raises(ValueError, match=f"{name} must be"):
        getattr(program.moves, command)(given)


def test_in_t1_a_motion_needs_the_start_key_and_is_slow(program: Program) -> None:
    controller = program.controller
    controller.turn_key(OperationMode.T1)
    assert controller.switch_drives(True).code is AckCode.OK
    assert program.ptp().code is AckCode.REFUSED
    controller.hold_start_key(True)
    assert program.ptp((160.0, *HOME_DEG[1:])).code is AckCode.OK
    program.cycles(300)
    controller.hold_start_key(False)
    assert program.finish() is AckCode.ABORTED
    fastest_deg_s = max(abs(b[0] - a[0]) for a, b in pairwise(program.axes)) / 0.004
    fastest_mm_s = max(dist(a[:3], b[:3]) for a, b in pairwise(program.places)) / 0.004
    assert 10.0 < fastest_deg_s <= 36.0
    assert fastest_mm_s <= 250.0
    controller.hold_enabling_switch(False)
    assert not controller.drives_on
    assert controller.switch_drives(True).code is AckCode.NOT_READY
