"""A hand on the guide, by the signals of arms whose weights and friction the estimate does not know."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from procedures.calibration.guide_load import (
    FALSE_ALARM_RATE,
    LoadEstimate,
    Standstill,
    estimate_load,
    point_jacobian,
)
from ronna_hw.arm.catalogue import ArmChoice
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arm.load_model import KR6, UR5E, LoadModel
from ronna_hw.arm.universal_robots import universal_robot
from ronna_hw.arrays import Array
from ronna_hw.vectors import JointVector, joint_vector, vector3
from sim.kuka.controller_parameters import ControllerParameters as KukaParameters
from sim.kuka.motor_currents import LARGEST_TORQUES_NM
from sim.universal_robots.controller_parameters import ControllerParameters as UrParameters
from sim.universal_robots.loads import TORQUE_PER_CURRENT_NM_A as PER_CURRENT_NM_A
from sim.universal_robots.loads import link_bodies
from sim.universal_robots.model import MODELS, TORQUES_NM
from sim.world.descriptions import DESCRIPTIONS
from sim.world.held_torques import HeldTorques, Stiction
from sim.world.scene.arm_design import CHOSEN

GUIDE_MM = (220.0, 0.0, 60.0)
KUKA_STICTION, UR_STICTION = KukaParameters().stiction_share, UrParameters().stiction_share
DRIVE_ERROR_SHARE = KukaParameters().current_error_share
NO_WAY = (0.0,) * 6
SEEN_N = 60.0
NONE = (0.0, 0.0, 0.0)


class Trial:
    """An arm as simulated: its signals at stops about home, with and without a hand."""

    def __init__(self, seed: int, choice: ArmChoice = ArmChoice.KR6) -> None:
        self.generator = generator = np.random.default_rng(seed)
        design = CHOSEN[choice]
        self.is_kr6 = choice is ArmChoice.KR6
        self.arm: Kinematics = kr6_r900(design.variant) if self.is_kr6 else universal_robot(design.variant)
        self.model = KR6 if self.is_kr6 else UR5E
        self.home_rad = np.radians(design.home_deg) + generator.uniform(-0.3, 0.3, 6)
        bodies = DESCRIPTIONS[design.variant].links or link_bodies(MODELS[design.variant])
        self._weights = HeldTorques(design.variant, bodies)
        share, largest = (KUKA_STICTION, LARGEST_TORQUES_NM) if self.is_kr6 else (UR_STICTION, TORQUES_NM)
        self._gears = Stiction([share * most for most in largest], seed)
        nominal = 100.0 / np.array(LARGEST_TORQUES_NM) if self.is_kr6 else 1.0 / np.array(PER_CURRENT_NM_A)
        self._per_Nm = (1.0 + self.is_kr6 * generator.normal(0.0, DRIVE_ERROR_SHARE, 6)) * nominal
        self._bias_N = generator.uniform(-1.0, 1.0, 3) * MODELS["ur5e"].force_bias_N
        self._stops = 0

    def stop(self, away_rad: float, force_N: Sequence[float] = NONE, number: int | None = None) -> Standstill:
        """Return the signals of a stop up to so far from home on each axis; the hand comes after it."""
        self._stops += 1
        joints = joint_vector(self.home_rad + away_rad * self.generator.uniform(-1.0, 1.0, 6))
        if self.is_kr6:
            self._weights.carry(1.4, (110.0, 0.0, 30.0))
        held = self._weights.weight_Nm(joints)
        number = self._stops if number is None else number
        self._gears.moving(held, NO_WAY)
        self._gears.at_rest(held, number)
        pushed = np.add(held, self._weights.against_force_Nm(joints, force_N, GUIDE_MM))
        motors = np.array(self._gears.at_rest(pushed.tolist(), number))
        if not self.is_kr6:
            motors = motors - held  # the controller states what it expects
        stated_N = None if self.is_kr6 else vector3(self._bias_N + force_N)
        return Standstill(joints, joint_vector(self._per_Nm * motors), 100, "guide", stated_N)

    def references(self, count: int = 5) -> list[Standstill]:
        return [self.stop(0.2) for _ in range(count)]

    def estimate(self, force_N: Sequence[float] = NONE) -> LoadEstimate:
        return self.against(self.references(), self.stop(0.0, force_N))

    def against(self, references: Sequence[Standstill], now: Standstill) -> LoadEstimate:
        return estimate_load(self.arm, self.model, references, now, GUIDE_MM)

    def direction(self) -> Array:
        way = self.generator.normal(size=3)
        return np.asarray(way / np.linalg.norm(way))


@cache
def leaned_on() -> list[tuple[Array, LoadEstimate]]:
    """Forces on the guide of a KR 6, each in a direction of its own, and their estimates."""
    found = []
    for seed in range(200):
        trial = Trial(seed)
        force_N = SEEN_N * trial.direction()
        found.append((force_N, trial.estimate(tuple(force_N))))
    return found


@pytest.mark.parametrize("trials", [200, pytest.param(500, marks=pytest.mark.slow)])
def test_an_unloaded_guide_is_no_alarm(trials: int) -> None:
    alarms = [Trial(seed).estimate().is_loaded for seed in range(trials)]
    assert np.mean(alarms) <= FALSE_ALARM_RATE


def test_a_person_who_leans_on_the_guide_of_a_kr6_is_seen() -> None:
    """Along the arm least, as neither A1 nor the upright axes have a lever there."""
    seen = [found.is_loaded for _, found in leaned_on()]
    along = [Trial(seed).estimate((SEEN_N, 0.0, 0.0)).is_loaded for seed in range(100)]
    assert np.mean(seen) > 0.85
    assert np.mean(along) > 0.7


@pytest.mark.parametrize(
    ("choice", "median_N", "most_N"), [(ArmChoice.KR6, 32.0, 70.0), (ArmChoice.UR5E, 11.0, 14.0)]
)
def test_from_which_force_on_a_hand_is_seen(choice: ArmChoice, median_N: float, most_N: float) -> None:
    """Median, and nine of ten, of postures and directions; less remains at the guide, over its stiffness."""
    seen_N = []
    for seed in range(60):
        trial = Trial(seed, choice)
        references, way = trial.references(), trial.direction()

        def is_seen(size_N: float, trial: Trial = trial, way: Array = way) -> bool:
            return trial.against(references, trial.stop(0.0, tuple(size_N * way), number=0)).is_loaded  # noqa: B023

        low_N, high_N = 0.0, 2.0 * most_N
        while high_N - low_N > 1.0:
            middle_N = (low_N + high_N) / 2.0
            low_N, high_N = (low_N, middle_N) if is_seen(middle_N) else (middle_N, high_N)
        seen_N.append(high_N)
    assert np.median(seen_N) < median_N
    assert np.quantile(seen_N, 0.9) < most_N


def test_the_force_is_within_its_covariance() -> None:
    squares = []
    for force_N, found in leaned_on():
        error_N = found.force_N - force_N
        squares.append(error_N @ np.linalg.solve(found.covariance_N2, error_N))
        assert found.displacement_mm == pytest.approx(found.force_N / KR6.stiffness_N_mm)
    assert np.mean(squares) < 3.0 * 1.2
    assert np.mean(np.array(squares) > 16.3) <= 0.01  # three degrees of freedom, one in a thousand


def test_a_load_that_friction_hides_leaves_no_alarm_and_a_covariance_that_allows_for_it() -> None:
    force_N = (8.0, 0.0, 0.0)
    for seed in range(50):
        found = Trial(seed).estimate(force_N)
        assert not found.is_loaded
        sizes_mm = np.sqrt(np.diag(found.displacement_covariance_mm2))
        assert np.all(3.0 * sizes_mm > 8.0 / KR6.stiffness_N_mm)


@pytest.mark.parametrize(
    ("arm", "model"),
    [(kr6_r900("kr6_r900_sixx"), KR6), (universal_robot("ur5e"), replace(UR5E, force_error_N=None))],
)
def test_without_friction_the_force_is_that_of_the_currents(arm: Kinematics, model: LoadModel) -> None:
    """The force alone changes the signals, against a reference in the same posture."""
    joints: JointVector = arm.home_rad
    force_N = np.array([10.0, -20.0, 5.0])
    torques = -point_jacobian(arm, joints, GUIDE_MM).T @ force_N / 1000.0
    signal = joint_vector(torques / np.array(model.torque_per_signal_Nm))
    rest, now = (Standstill(joints, one, 100, "guide") for one in ((0.0,) * 6, signal))
    exact = replace(model, stiction_Nm=(1e-3,) * 6, noise=1e-6, torque_error_share=1e-6)
    found = estimate_load(arm, exact, [rest], now, GUIDE_MM)
    assert found.force_N == pytest.approx(force_N, abs=1e-3)
    assert found.is_loaded


def test_a_force_sensor_sees_what_friction_hides_from_the_currents() -> None:
    arm, bias_N, push_N = universal_robot("ur5e"), np.array([1.5, -2.0, 0.5]), np.array([0.0, 0.0, -12.0])
    torques = -point_jacobian(arm, arm.home_rad, GUIDE_MM).T @ push_N / 1000.0
    shows = np.sign(torques) * np.maximum(np.abs(torques) - UR5E.stiction_Nm, 0.0)

    def stop(torques_Nm: Array, force_N: Array) -> Standstill:
        signal = joint_vector(torques_Nm / np.array(UR5E.torque_per_signal_Nm))
        return Standstill(arm.home_rad, signal, 100, "guide", vector3(force_N))

    references = [stop(np.zeros(6), bias_N)] * 3
    found = estimate_load(arm, UR5E, references, stop(shows, bias_N + push_N), GUIDE_MM)
    assert found.is_loaded
    assert found.force_N == pytest.approx(push_N, abs=6.0)
    assert not estimate_load(arm, UR5E, references, references[0], GUIDE_MM).is_loaded
    by_currents = replace(UR5E, force_error_N=None)
    assert not estimate_load(arm, by_currents, references, stop(shows, bias_N), GUIDE_MM).is_loaded


def test_another_tool_at_the_references_makes_the_estimate_less_certain() -> None:
    trial = Trial(3)
    references = [trial.stop(0.2) for _ in range(5)]
    others = [replace(one, tool="stereo_head") for one in references]
    now, arm = trial.stop(0.0), kr6_r900("kr6_r900_sixx")
    same, other = (
        estimate_load(arm, KR6, stops, now, GUIDE_MM).covariance_N2 for stops in (references, others)
    )
    assert np.trace(other) > 1.2 * np.trace(same)


def test_a_load_needs_an_unloaded_standstill() -> None:
    with pytest.raises(ValueError, match="unloaded standstill"):
        estimate_load(kr6_r900("kr6_r900_sixx"), KR6, [], Trial(1).stop(0.0), GUIDE_MM)
