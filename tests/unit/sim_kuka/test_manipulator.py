"""The arm's kinematics, nominal and true, and where it comes to rest."""

from __future__ import annotations

from math import cos, pi, radians
from typing import Any

import numpy as np
import pytest
from coded_errors import raises
from kr6_golden_poses import GOLDEN
from shared_controller import Make

from sim.errors import BAD_SCENE
from sim.world.nominal_arm import description, frame_of, pose_of_frame, status_and_turn
from sim.world.scene.as_built import draw_arm
from sim.world.scene.model import ArmTruth
from sim.world.true_arm import JointChain, TrueArm

HOME_DEG = (0.0, -90.0, 90.0, 0.0, 90.0, 0.0)


def in_radians(axes_deg: tuple[float, ...]) -> list[float]:
    return [radians(angle) for angle in axes_deg]


@pytest.mark.parametrize("variant", ["kr6_r900_sixx", "kr6_r900_2"])
@pytest.mark.parametrize("row", GOLDEN)
def test_the_chain_reaches_the_golden_poses(variant: str, row: tuple[tuple[float, ...], ...]) -> None:
    axes_deg, sixx_mm, second_mm, orientation_deg = row
    pose = JointChain(description(variant)).flange(in_radians(axes_deg))
    expected = pose_of_frame((*(sixx_mm if variant == "kr6_r900_sixx" else second_mm), *orientation_deg))
    assert np.abs(pose[:3, 3] - expected[:3, 3]).max() < 0.001
    turn = expected[:3, :3].T @ pose[:3, :3]
    angle_deg = np.degrees(np.linalg.norm([turn[2, 1], turn[0, 2], turn[1, 0]]))
    assert angle_deg < 0.001


def test_a_frame_survives_writing_and_reading_even_at_gimbal_lock() -> None:
    generator = np.random.default_rng(5)
    for _ in range(500):
        A, B, C = generator.uniform((-180, -90, -180), (180, 90, 180))
        B = generator.choice([B, 90.0, -90.0])
        pose = pose_of_frame((1.0, 2.0, 3.0, A, B, C))
        assert np.allclose(pose_of_frame(frame_of(pose)), pose, atol=1e-9)


def test_the_reported_pose_is_that_of_the_axes_with_tool_and_base(make_bench: Make) -> None:
    generator = np.random.default_rng(12)
    controller = make_bench(start=False).controller
    for number in range(1, 17):
        tool, base = (generator.uniform(-150.0, 150.0, 6) for _ in range(2))
        tool[4], base[4] = tool[4] / 2, base[4] / 2
        controller.set_tool(number, tool)
        controller.set_base(number, base)
        flange = JointChain(controller.arm.description).flange(in_radians(tuple(controller.arm.axes_deg)))
        expected = np.linalg.inv(pose_of_frame(base)) @ flange @ pose_of_frame(tool)
        assert np.abs(pose_of_frame(controller.arm.frame) - expected).max() < 1e-9


def test_inverse_kinematics_finds_the_joints_of_a_nearby_pose() -> None:
    chain = JointChain(description("kr6_r900_sixx"))
    joints = in_radians((30, -75, 110, -20, 45, 60))
    found = chain.joints_at(chain.flange(joints), [angle + 0.03 for angle in joints])
    assert found is not None
    assert np.allclose(found, joints, atol=1e-8)


def test_inverse_kinematics_gives_up_out_of_reach() -> None:
    chain = JointChain(description("kr6_r900_sixx"))
    far = chain.flange(in_radians((0, 0, 0, 0, 0, 0)))
    far[0, 3] += 500.0
    assert chain.joints_at(far, in_radians((0, -20, 30, 0, 10, 0))) is None


def test_status_and_turn_distinguish_postures() -> None:
    arm = description("kr6_r900_sixx")
    assert status_and_turn(arm, (0, -90, 90, 0, 90, 0)) == (2, 2)
    assert status_and_turn(arm, (0, -90, 90, 0, -90, 0)) == (6, 18)
    assert status_and_turn(arm, (0, -150, 0, 0, 10, -1))[0] & 1 == 1
    assert arm.stretched_A3_deg == pytest.approx(4.76, abs=0.01)
    assert description("kr6_r900_2").stretched_A3_deg == pytest.approx(3.41, abs=0.01)


def test_a_true_arm_without_errors_is_the_nominal_arm(perfect_arm: Make) -> None:
    true = TrueArm(perfect_arm(), seed=0)
    joints = in_radians((30, -75, 110, -20, 45, 60))
    nominal = JointChain(description("kr6_r900_sixx")).flange(joints)
    assert np.allclose(true.at_rest(joints, (1.0,) * 6, 3), nominal, atol=1e-9)


def test_each_error_moves_the_true_flange_by_its_size(perfect_arm: Make) -> None:
    home = in_radians(HOME_DEG)
    nominal = JointChain(description("kr6_r900_sixx")).flange(home)[:3, 3]

    def moved_mm(flank: float = 0.0, **errors: object) -> float:
        pose = TrueArm(perfect_arm(**errors), seed=0).moving(home, (flank,) * 6)
        return float(np.linalg.norm(pose[:3, 3] - nominal))

    one_deg_100th = radians(0.01)
    offsets = [(0.0,) * n + (one_deg_100th,) + (0.0,) * (5 - n) for n in range(6)]
    # Published sensitivity of the flange at this pose: 0.01 deg on each axis.
    for offset, expected_um in zip(offsets, (78, 102, 74, 14, 14, 0), strict=True):
        assert moved_mm(joint_offset_rad=offset) == pytest.approx(expected_um / 1000, abs=0.001)
    first = (one_deg_100th,) + (0.0,) * 5
    assert moved_mm(backlash_rad=first, flank=1.0) == pytest.approx(0.039, abs=0.001)
    assert moved_mm(backlash_rad=first, flank=0.0) == 0.0
    # The upper arm is upright, the forearm stretched out: only A3 sags.
    assert moved_mm(sag_rad=(0.0, one_deg_100th)) == pytest.approx(0.074, abs=0.001)
    assert moved_mm(harmonic_1_rad=first, harmonic_1_phase_rad=(radians(90),) * 6) == pytest.approx(
        0.078, abs=0.001
    )


def test_sag_lowers_the_stretched_arm(perfect_arm: Make) -> None:
    stretched = in_radians((0, 0, 0, 0, 0, 0))
    sagging = TrueArm(perfect_arm(sag_rad=(radians(0.03), radians(0.03))), seed=0)
    nominal = JointChain(description("kr6_r900_sixx")).flange(stretched)
    assert sagging.moving(stretched, (0.0,) * 6)[2, 3] < nominal[2, 3] - 0.5


def test_repeatability_depends_on_the_motion_number_alone(perfect_arm: Make) -> None:
    home = in_radians(HOME_DEG)
    true = TrueArm(perfect_arm(repeatability_mm=0.015), seed=4)
    places = np.array([true.at_rest(home, (0.0,) * 6, number)[:3, 3] for number in range(400)])
    again = TrueArm(perfect_arm(repeatability_mm=0.015), seed=4).at_rest(home, (0.0,) * 6, 17)
    assert np.array_equal(again[:3, 3], places[17])
    assert np.allclose(places.std(axis=0), 0.015, rtol=0.15)


def test_a_drawn_arm_is_off_by_as_much_as_an_uncalibrated_robot() -> None:
    errors_mm = []
    for seed in range(30):
        truth = draw_arm(np.random.default_rng(seed))
        joints = in_radians(truth.home_deg)
        true = TrueArm(truth, seed).at_rest(joints, (0.0,) * 6, 0)
        errors_mm.append(
            np.linalg.norm(true[:3, 3] - JointChain(description("kr6_r900_sixx")).flange(joints)[:3, 3])
        )
    assert 0.5 < float(np.mean(errors_mm)) < 3.0


GOALS = [(5.0, -3.0, 4.0, 10.0, -6.0, 8.0), (-2.0, 2.0, 1.0, -4.0, 3.0, 0.0), (1.0, 2.0, 1.0, 0.0, 3.0, 5.0)]


@pytest.fixture
def truth() -> ArmTruth:
    return draw_arm(np.random.default_rng(3))


def profile(begin: tuple[float, ...], end: tuple[float, ...]) -> list[list[float]]:
    """A smooth move of 300 cycles."""
    shares = [0.5 - 0.5 * cos(pi * n / 300) for n in range(1, 301)]
    return [[a + share * (b - a) for a, b in zip(begin, end, strict=True)] for share in shares]


def poses(bench: Any, idle: list[int], lost: set[int] = frozenset()) -> list[np.ndarray]:  # type: ignore[assignment]
    """True poses at rest after each goal, with `idle` cycles after each and replies lost on the way."""
    bench.enter_movecorr()
    found, place = [], (0.0,) * 6
    for goal, pause in zip(GOALS, idle, strict=True):
        for number, step in enumerate(profile(place, goal)):
            if number in lost:
                bench.miss()
            else:
                bench.answer(step)
        place = goal
        bench.rest(goal)
        for _ in range(pause):
            bench.answer(goal)
        assert bench.published[-1].at_rest
        found.append(bench.published[-1].robot_from_flange)
    return found


@pytest.mark.parametrize(
    ("idle", "lost"), [([500, 3, 77], set()), ([0, 0, 0], {1, 30, 31, 150, 298, 299})], ids=["idle", "lost"]
)
def test_neither_idle_time_nor_lost_replies_change_the_pose_at_rest(
    make_bench: Make, truth: ArmTruth, idle: list[int], lost: set[int]
) -> None:
    first = poses(make_bench(truth=truth), [0, 0, 0])
    second = poses(make_bench(truth=truth), idle, lost)
    for one, other in zip(first, second, strict=True):
        assert np.array_equal(one, other)


def test_motions_are_counted_by_commands_and_not_by_the_pauses_between_them(
    make_bench: Make, truth: ArmTruth
) -> None:
    for pause in (0, 400):
        bench = make_bench(truth=truth)
        bench.enter_movecorr()
        place = (0.0,) * 6
        for goal in GOALS:
            for step in profile(place, goal):
                bench.answer(step)
            for _ in range(pause):
                bench.answer(goal)
            place = goal
        bench.rest(place)
        assert bench.published[-1].motion_number == len(GOALS)


def test_another_seed_changes_the_pose_at_rest_by_the_repeatability(
    make_bench: Make, truth: ArmTruth
) -> None:
    first = poses(make_bench(truth=truth, seed=1), [0, 0, 0])
    second = poses(make_bench(truth=truth, seed=2), [0, 0, 0])
    distance_mm = [float(np.linalg.norm(a[:3, 3] - b[:3, 3])) for a, b in zip(first, second, strict=True)]
    assert all(0.001 < distance < 0.15 for distance in distance_mm)


def test_the_direction_of_approach_decides_on_which_backlash_flank_the_arm_rests(
    make_bench: Make, perfect_arm: Make
) -> None:
    truth = perfect_arm(backlash_rad=(np.radians(0.02),) + (0.0,) * 5)
    seen_mm = []
    for overshoot in (0.0, 4.0):
        bench = make_bench(truth=truth)
        bench.enter_movecorr()
        goal, beyond = (3.0,) + (0.0,) * 5, (3.0 + overshoot,) + (0.0,) * 5
        bench.ramp(beyond)
        bench.go(goal, from_deg=beyond)
        assert bench.controller.arm.axes_deg[0] == 3.0
        seen_mm.append(bench.published[-1].robot_from_flange[:3, 3])
    # The whole backlash at 445 mm from the axis.
    assert float(np.linalg.norm(seen_mm[0] - seen_mm[1])) == pytest.approx(445.0 * np.radians(0.02), rel=0.01)


def test_the_true_flange_never_jumps(make_bench: Make, truth: ArmTruth) -> None:
    bench = make_bench(truth=truth)
    poses(bench, [0, 5, 0])
    places_mm = np.array([state.robot_from_flange[:3, 3] for state in bench.published])
    assert float(np.linalg.norm(np.diff(places_mm, axis=0), axis=1).max()) < 1.0


def test_nothing_is_published_while_nothing_changes(bench: Any) -> None:
    bench.enter_movecorr()
    before = len(bench.published)
    for _ in range(100):
        bench.answer()
    assert len(bench.published) == before


def test_the_pose_believed_by_the_controller_stays_nominal(make_bench: Make, truth: ArmTruth) -> None:
    bench = make_bench(truth=truth.model_copy(update={"home_deg": (0.0, -90.0, 90.0, 0.0, 90.0, 0.0)}))
    believed = np.array(bench.controller.arm.frame[:3])
    really = bench.published[-1].robot_from_flange[:3, 3]
    assert believed == pytest.approx([445.0, 0.0, 810.0])
    assert 0.1 < float(np.linalg.norm(believed - really)) < 6.0


def test_the_arm_of_another_make_is_refused_with_the_known_ones() -> None:
    with raises(BAD_SCENE, match="kr6_r900_sixx or kr6_r900_2, not the scene's arm ur5e"):
        description("ur5e")
