"""Distances agree with a third-party library, and between planning and the live watch."""

import math
import random
from dataclasses import replace

import coal
import numpy as np
import pytest
from calibrated_ur import CALIBRATED_UR

from ronna_hw.arm.clearance.bodies import (
    Bodies,
    Capsule,
    Corridor,
    Surroundings,
    covering_ellipsoid,
    segment_distance_mm,
)
from ronna_hw.arm.clearance.live_watch import LiveWatch, PlacedBodies
from ronna_hw.arm.clearance.pair_distances import segment_distances
from ronna_hw.arm.clearance.sweep import sweep
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.kr6_r900 import R900_2, kr6_r900
from ronna_hw.arm.pose import Pose
from ronna_hw.arm.universal_robots import universal_robot
from ronna_hw.collision_config import CollisionConfig
from ronna_hw.vectors import JointVector, Vector3

MODEL = kr6_r900(R900_2)
CYCLE_S = 0.004
CELL = CollisionConfig()
TOOL = Pose((220.0, 0.0, 60.0))
HEAD = Pose.from_kuka(760.0, 10.0, 200.0, 90.0, 0.0, 30.0)
SEMI_AXES_MM = (75.0, 95.0, 90.0)
AROUND = CELL.build_surroundings(CELL.guide, TOOL, HEAD, SEMI_AXES_MM, ((700.0, 30.0, 290.0),))
BODIES = Bodies(MODEL, AROUND)
HOME = MODEL.home_rad


def _point(rng: random.Random, spread_mm: float = 200.0) -> Vector3:
    return (rng.gauss(0, spread_mm), rng.gauss(0, spread_mm), rng.gauss(0, spread_mm))


def _capsule(rng: random.Random) -> Capsule:
    start = _point(rng)
    kind = rng.random()
    if kind < 0.1:
        return Capsule(start, start, rng.uniform(1, 60))
    if kind < 0.3:  # parallel to others of its kind: the degenerate case of the formula
        return Capsule(start, (start[0], start[1], start[2] + rng.uniform(1, 300)), rng.uniform(1, 60))
    return Capsule(start, _point(rng), rng.uniform(1, 60))


def _coal_distance(a: Capsule, b: Capsule) -> float:
    """Of the bare axes, by thin capsules in metres would lose digits: radius 1 mm, added again."""
    shapes = []
    for capsule in (a, b):
        start, end = np.array(capsule.start_mm), np.array(capsule.end_mm)
        length = float(np.linalg.norm(end - start))
        shape = coal.Capsule(1.0, length) if length > 1e-9 else coal.Sphere(1.0)
        axis = (end - start) / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
        across = np.cross([0.0, 0.0, 1.0], axis)
        sine, cosine = float(np.linalg.norm(across)), float(axis[2])
        if sine < 1e-12:
            turn = np.eye(3) if cosine > 0 else np.diag([1.0, -1.0, -1.0])
        else:
            k = across / sine
            cross = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
            turn = np.eye(3) + sine * cross + (1 - cosine) * cross @ cross
        shapes.append((shape, coal.Transform3s(turn, (start + end) / 2)))
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    coal.distance(*shapes[0], *shapes[1], request, result)
    return float(result.min_distance) + 2.0 - a.radius_mm - b.radius_mm


def gap_mm(a: Capsule, b: Capsule) -> float:
    """Distance of two surfaces; negative when the capsules overlap."""
    apart = segment_distance_mm(a.start_mm, a.end_mm, b.start_mm, b.end_mm)
    return apart - a.radius_mm - b.radius_mm


def test_the_distance_of_two_capsules_agrees_with_coal() -> None:
    rng = random.Random(1)
    compared = 0
    for _ in range(2000):
        a, b = _capsule(rng), _capsule(rng)
        apart = gap_mm(a, b) + a.radius_mm + b.radius_mm
        if apart > 2.5:  # coal's thin capsules overlap below
            assert gap_mm(a, b) == pytest.approx(_coal_distance(a, b), abs=2e-3)
            compared += 1
    assert compared > 1900


def test_both_formulas_give_the_same_distance() -> None:
    rng = random.Random(2)
    pairs = [(_capsule(rng), _capsule(rng)) for _ in range(3000)]
    columns = [
        np.array(values).T
        for values in zip(*((a.start_mm, a.end_mm, b.start_mm, b.end_mm) for a, b in pairs), strict=True)
    ]
    batch = segment_distances(*columns)
    one_by_one = [gap_mm(a, b) + a.radius_mm + b.radius_mm for a, b in pairs]
    assert np.allclose(batch, one_by_one, atol=1e-7)


@pytest.mark.parametrize("axes", [SEMI_AXES_MM, (90.0, 75.0, 95.0), (80.0, 80.0, 80.0), (60.0, 100.0, 110.0)])
def test_the_capsules_of_a_head_enclose_its_ellipsoid_tightly(axes: Vector3) -> None:
    pose = Pose.from_kuka(10.0, -20.0, 30.0, 40.0, 50.0, 60.0)
    capsules = covering_ellipsoid(axes, pose)
    rng = np.random.default_rng(4)
    directions = rng.normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    surface = directions * np.array(axes)
    for x, y, z in surface.tolist():
        point = pose.apply((x, y, z))
        assert min(gap_mm(Capsule(point, point, 0.0), one) for one in capsules) <= 1e-9
    overshoot = max(capsules[0].radius_mm - min(axes), 0.0)
    assert overshoot <= 0.4 * (max(axes) - min(axes)) + 1e-9


@pytest.mark.parametrize(
    "arm", [MODEL, universal_robot("ur5"), CALIBRATED_UR], ids=lambda arm: type(arm).__name__
)
def test_planning_and_live_watch_see_the_same_bodies(arm: Kinematics) -> None:
    rng = random.Random(5)
    bodies = Bodies(arm, AROUND)
    joints: list[JointVector] = []
    for _ in range(40):
        A1, A2, A3, A4, A5, A6 = (
            rng.uniform(low, high) for low, high in zip(arm.lower_rad, arm.upper_rad, strict=True)
        )
        joints.append((A1, A2, A3, A4, A5, A6))
    swept = sweep(bodies, joints)
    for row, vector in enumerate(joints):
        assert np.allclose(swept.ends_mm[row], list(PlacedBodies(bodies, vector)), atol=1e-8)
        watch = LiveWatch(bodies, CYCLE_S, vector)
        live = [watch._gap(number, watch._placed) for number in range(len(bodies.pairs))]
        assert np.allclose(swept.gaps_mm[row], live, atol=1e-8)


def test_a_watched_arm_that_stands_for_long_keeps_nothing_of_its_cycles() -> None:
    watch = LiveWatch(Bodies(MODEL, AROUND), CYCLE_S, MODEL.home_rad)
    for _ in range(1000):
        watch.check(MODEL.home_rad)
        watch.sent(MODEL.home_rad)
    assert len(watch._trials) <= 1


@pytest.mark.parametrize(
    "arm", [MODEL, universal_robot("ur5"), CALIBRATED_UR], ids=lambda arm: type(arm).__name__
)
def test_no_body_moves_farther_than_the_joint_levers_allow(arm: Kinematics) -> None:
    rng = random.Random(6)
    bodies = Bodies(arm, AROUND)
    levers = arm.levers_mm([end for part in AROUND.tool for end in part.capsule[:2]])
    largest = 0.0
    for _ in range(2000):
        start = tuple(rng.uniform(a, b) for a, b in zip(arm.lower_rad, arm.upper_rad, strict=True))
        size = 10.0 ** rng.uniform(-5.0, 0.0)
        end = tuple(angle + rng.uniform(-size, size) for angle in start)
        bound = sum(lever * abs(b - a) for lever, a, b in zip(levers, start, end, strict=True))
        moved = max(
            math.dist(before, now)
            for was, is_now in zip(PlacedBodies(bodies, start), PlacedBodies(bodies, end), strict=True)
            for before, now in zip(was, is_now, strict=True)
        )
        assert moved <= bound * (1.0 + 1e-9)
        largest = max(largest, moved / bound)
    assert largest > 0.7  # and the bound is no wild guess


def test_surroundings_round_trip_as_one_line() -> None:
    corridor = Corridor((1.0, 2.0, 3.0), (4.0, 5.0, 6.0), 2.5)
    line = replace(AROUND, corridor=corridor).to_json()
    assert "\n" not in line
    assert Surroundings.from_json(line) == replace(AROUND, corridor=corridor)
    assert Surroundings.from_json(Surroundings().to_json()) == Surroundings()


def test_a_corridor_is_straight_and_narrow_and_ends_behind_the_target() -> None:
    corridor = Corridor((0.0, 0.0, 0.0), (0.0, 0.0, -50.0), 2.5)
    assert corridor.holds((0.0, 0.0, 100.0), (2.0, 1.0, -50.0))
    assert not corridor.holds((0.0, 0.0, 100.0), (2.6, 0.0, -20.0))
    assert not corridor.holds((0.0, 0.0, 100.0), (0.0, 0.0, -54.0))
    assert not corridor.holds((50.0, 0.0, 100.0), (0.0, 0.0, -20.0))


def test_the_arm_at_home_is_clear_of_itself_and_of_the_patient() -> None:
    for tool in (CELL.guide, CELL.stereo_head):
        swept = sweep(Bodies(MODEL, CELL.build_surroundings(tool, TOOL, HEAD, SEMI_AXES_MM)), [HOME])
        assert swept.gaps_mm.min() > CELL.margin_mm
