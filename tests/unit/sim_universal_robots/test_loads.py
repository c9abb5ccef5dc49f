"""Loads on the simulated tool: force, its estimate, torques and the safety limit."""

from __future__ import annotations

from math import hypot, sqrt
from statistics import fmean, pstdev

import pytest

from ronna_hw.wire.universal_robots import SafetyMode
from sim.universal_robots.controller import Controller
from sim.universal_robots.controller_parameters import ControllerParameters
from sim.universal_robots.kinematics import LinkPose
from sim.universal_robots.loads import TORQUE_PER_CURRENT_NM_A, resistance_n
from sim.universal_robots.model import MODELS, TORQUES_NM
from sim.universal_robots.programs.statements import run_at_once
from sim.universal_robots.variables import PLACES

EXACT = "force_error_scale=0.000001"
QUIET = "current_noise_a=0.000001"
SETTLED_CYCLES = 100


def force_n(controller: Controller) -> tuple[float, float, float]:
    x, y, z, *_ = controller.robot.values[PLACES["actual_TCP_force"]]
    return x, y, z


def torques_nm(controller: Controller) -> list[float]:
    return list(controller.robot.values[PLACES["target_moment"]])


def currents_a(controller: Controller) -> list[float]:
    return list(controller.robot.values[PLACES["actual_current"]])


def make(*assignments: str, arm: str = "ur5e") -> Controller:
    return Controller(MODELS[arm], ControllerParameters.parse(assignments), seed=3)


def run(controller: Controller, cycles: int = SETTLED_CYCLES) -> None:
    for _ in range(cycles):
        controller.step()


def test_an_axial_load_pushes_the_tool_back_along_its_axis() -> None:
    controller = make(EXACT)
    controller.loads.axial_n = 30.0
    run(controller)
    tool = controller.robot.tool_frame(controller.robot.drives.actual)
    expected = (-30.0 * tool.r02, -30.0 * tool.r12, -30.0 * tool.r22)
    assert force_n(controller) == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("arm", MODELS)
def test_the_estimate_of_a_free_tool_is_noisy_and_biased_as_its_generation(arm: str) -> None:
    controller = make(arm=arm)
    samples = []
    for _ in range(1000):
        controller.step()
        samples.append(force_n(controller))
    for axis in zip(*samples, strict=True):
        assert pstdev(axis) == pytest.approx(MODELS[arm].force_noise_N, rel=0.15)
        assert abs(fmean(axis)) < 1.2 * MODELS[arm].force_bias_N


def test_a_mass_that_the_controller_was_not_told_appears_as_its_weight() -> None:
    controller = make(EXACT, "tool_mass_kg=1.2")
    run(controller)
    assert force_n(controller) == pytest.approx((0.0, 0.0, -1.2 * 9.81), abs=0.01)
    run_at_once(controller.robot, "sec load():\n  set_payload(1.2, [0, 0, 0.06])\nend\n")
    run(controller)
    assert hypot(*force_n(controller)) < 0.01


def test_gravity_turns_the_shoulder_of_a_stretched_arm_and_not_its_base() -> None:
    controller = Controller(MODELS["ur5e"], ControllerParameters.parse(()), start_rad=(0.0,) * 6)
    run(controller, 1)
    base, shoulder, *_ = torques_nm(controller)
    assert base == pytest.approx(0.0, abs=1e-9)
    weight_nm = 9.81 * 0.1 * 0.817  # of a payload at the end of the arm
    controller.robot.set_payload(0.1, (0.0, 0.0, 0.0))
    run(controller, 1)
    assert torques_nm(controller)[1] - shoulder == pytest.approx(-weight_nm, rel=0.01)
    assert abs(shoulder) < 150.0


def test_a_force_on_the_tool_takes_current_of_the_joints() -> None:
    controller = make(EXACT)
    run(controller, 2)
    before = list(controller.robot.values[PLACES["actual_current"]])
    controller.loads.axial_n = 50.0
    run(controller, 2)
    after = controller.robot.values[PLACES["actual_current"]]
    assert sqrt(sum((a - b) ** 2 for a, b in zip(after, before, strict=True))) > 0.5


def test_a_force_that_comes_at_rest_shows_in_the_currents_by_what_exceeds_the_stiction() -> None:
    slippery, sticky = make(EXACT, QUIET, "stiction_share=0.000001"), make(EXACT, QUIET)
    changes_nm = []
    for controller in (slippery, sticky):
        run(controller, 2)
        before = currents_a(controller)
        controller.loads.axial_n = 80.0
        run(controller, 2)
        steps = zip(before, currents_a(controller), TORQUE_PER_CURRENT_NM_A, strict=True)
        changes_nm.append([(b - a) * per_a for a, b, per_a in steps])
    share = ControllerParameters.parse(()).stiction_share
    for full, seen, most in zip(*changes_nm, TORQUES_NM, strict=True):
        assert abs(full) - abs(seen) <= 2.0 * share * most + 1e-3
    assert max(map(abs, changes_nm[0])) > max(map(abs, changes_nm[1])) > 5.0


def test_currents_of_an_arm_that_nobody_touches_are_the_expected_ones_within_friction_and_noise() -> None:
    controller = make()
    samples = []
    for _ in range(500):
        controller.step()
        samples.append(currents_a(controller))
    parameters = ControllerParameters.parse(())
    expected = controller.robot.values[PLACES["target_current"]]
    for sampled, one, most, per_a in zip(
        zip(*samples, strict=True), expected, TORQUES_NM, TORQUE_PER_CURRENT_NM_A, strict=True
    ):
        assert pstdev(sampled) == pytest.approx(parameters.current_noise_a, rel=0.15)
        assert abs(fmean(sampled) - one) < parameters.stiction_share * most / per_a + 0.01


def test_a_force_above_the_safety_limit_is_a_protective_stop() -> None:
    controller = make("safety_force_n=100")
    controller.loads.axial_n = 99.0
    run(controller, 5)
    assert controller.modes.safety_mode is SafetyMode.NORMAL
    controller.loads.axial_n = 101.0
    run(controller, 5)
    assert controller.modes.safety_mode is SafetyMode.PROTECTIVE_STOP


def test_tissue_resists_as_skin_bone_and_brain() -> None:
    parameters = ControllerParameters.parse(())
    depths = (-1.0, 0.0, 4.0, 5.5, 8.0, 12.0)
    assert [resistance_n(depth, parameters) for depth in depths] == [0.0, 0.0, 2.0, 20.0, 20.0, 1.0]


def test_tissue_lies_ahead_of_the_instrument_in_a_holder() -> None:
    """Its axis leads across the flange."""
    loads = make(EXACT).loads
    loads.instrument = LinkPose(0.0, 0.0, 1.0, 0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 0.1, 0.0, 0.0)
    loads.meet_tissue(0.0)
    assert loads.tissue is not None
    robot = make(EXACT).robot
    flange = robot.kinematics.flange(robot.drives.actual)
    assert loads.tissue.axis == pytest.approx((flange.r00, flange.r10, flange.r20))


def test_an_instrument_that_is_drawn_back_is_relieved() -> None:
    controller = make(EXACT)
    loads, tool = controller.loads, controller.robot.tool_frame(controller.robot.drives.actual)
    loads.meet_tissue(0.0)
    assert loads.tissue is not None

    def at(depth_mm: float) -> float:
        assert loads.tissue is not None
        axis, origin = (tool.r02, tool.r12, tool.r22), (tool.x, tool.y, tool.z)
        return loads.tissue.force_n([p + depth_mm / 1000.0 * a for p, a in zip(origin, axis, strict=True)])

    assert at(8.0) == pytest.approx(20.0)
    assert at(7.5) == pytest.approx(10.0)
    assert at(6.0) == 0.0
