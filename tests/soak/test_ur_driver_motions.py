"""Ten thousand random motions of a calibrated arm, in simulated time: no limit of the stream is broken."""

from __future__ import annotations

import random
from contextlib import suppress
from dataclasses import replace
from math import cos, sin

import numpy as np
import pytest
import rtde_stand
from calibrated_ur import CALIBRATED_UR, CALIBRATION
from rtde_stand import CYCLE_S, RtdeStand

from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.clearance.sweep import sweep_path
from ronna_hw.arm.motion.limits import working_limits
from ronna_hw.arm.motion.planning import MotionPlan, plan_joint_move, plan_line
from ronna_hw.arm.pose import Pose
from ronna_hw.arm_stream.records import LinkFault, MotionResult, Move, StopOrder
from ronna_hw.errors import RonnaError
from ronna_hw.vectors import JointVector, joint_vector

pytestmark = [pytest.mark.soak, pytest.mark.timeout(3600)]

MOTIONS, SHARES = 10_000, 20  # each share with a seed of its own, so that several workers take part
LIMITS = replace(working_limits(CALIBRATED_UR), cycle_s=CYCLE_S)
TRAVEL_RAD, TRAVEL_MM, TURN_RAD = 0.3, 60.0, 0.2
SHORTEST = 0.03  # share of these: as many short motions as long ones, for limits are reached in ramps
TOOL_MM = (0.0, 0.0, 150.0)
ROUNDING = 1.01
STOPPED_SHARE, SLOWED_SHARE = 0.2, 0.2
HOMING_SHARE = 0.01  # back to the middle of the room
LONGEST_CYCLES = 20_000


def plan_any(chance: random.Random, here: JointVector) -> MotionPlan:
    """Return a joint move or a line from here on which the arm does not come near itself."""
    while True:
        with suppress(RonnaError):  # out of range or reach, singular, or too near
            plan = plan_once(chance, here)
            sweep_path(CALIBRATED_UR, plan, Surroundings()).require("the path")
            return plan


def plan_once(chance: random.Random, here: JointVector) -> MotionPlan:
    if chance.random() < HOMING_SHARE:
        return plan_joint_move(CALIBRATED_UR, here, rtde_stand.START, LIMITS)
    share = SHORTEST ** chance.random()

    def within(most: float) -> float:
        return share * chance.uniform(-most, most)

    if chance.random() < 0.5:
        away = joint_vector(angle + within(TRAVEL_RAD) for angle in here)
        return plan_joint_move(CALIBRATED_UR, here, away, LIMITS)
    flange = CALIBRATED_UR.forward(here)
    x, y, z = (one + within(TRAVEL_MM) for one in flange.position_mm)
    turn = within(TURN_RAD)
    c, s = cos(turn), sin(turn)
    turned = flange.compose(Pose((0.0, 0.0, 0.0), (c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0)))
    return plan_line(CALIBRATED_UR, here, Pose((x, y, z), turned.rotation), LIMITS, TOOL_MM)


def shares_of_limits(goals: list[JointVector]) -> tuple[float, float]:
    """Return the largest shares of joint speed and acceleration in set-points."""
    speeds = np.diff(np.array(goals), axis=0) / CYCLE_S
    accelerations = np.diff(speeds, axis=0) / CYCLE_S
    return (
        float(np.abs(speeds / LIMITS.speed_rad_s).max()),
        float(np.abs(accelerations / LIMITS.acceleration_rad_s2).max()),
    )


@pytest.mark.parametrize("seed", range(SHARES))
def test_random_motions_break_no_limit(seed: int) -> None:
    chance = random.Random(seed)
    numbers = (*CALIBRATION.theta_rad, *CALIBRATION.a_mm, *CALIBRATION.d_mm, *CALIBRATION.alpha_rad)
    stand = RtdeStand(limits=LIMITS, calibration=numbers).begin()
    fastest = hardest = 0.0
    cycles = 0
    for _ in range(MOTIONS // SHARES):
        del stand.goals[:-3]
        stand.give(Move(plan_any(chance, stand.goal)))
        stops_at = chance.randrange(400) if chance.random() < STOPPED_SHARE else -1
        slows_at = chance.randrange(400) if chance.random() < SLOWED_SHARE else -1
        for cycle in range(LONGEST_CYCLES):
            if cycle == stops_at and stand.session.moving:
                stand.stop(StopOrder.HOLD)
            stand.fraction = chance.choice((0.3, 0.6)) if cycle == slows_at else stand.fraction
            if cycle == slows_at + 200:
                stand.fraction = 1.0
            stand.cycle()
            if cycle and stand.session.result is not MotionResult.RUNNING:
                break
        stand.fraction = 1.0
        assert stand.session.fault is LinkFault.NONE
        assert stand.session.result in (MotionResult.DONE, MotionResult.STOPPED)
        cycles += len(stand.goals)
        speed, acceleration = shares_of_limits(stand.goals)
        fastest, hardest = max(fastest, speed), max(hardest, acceleration)
        assert speed < ROUNDING
        assert acceleration < ROUNDING
    print(f"seed {seed}: {cycles} cycles, speed {fastest:.4f} and acceleration {hardest:.4f} of the limits")
