"""The simulated arm in the world: what observers see of it."""

from __future__ import annotations

import numpy as np
import pytest
from coded_errors import raises

from ronna_hw.arm.catalogue import ArmChoice
from sim.errors import BAD_SCENE
from sim.universal_robots.arm_in_world import ArmInWorld, require_arm
from sim.universal_robots.controller_parameters import ControllerParameters
from sim.universal_robots.drives import Drives
from sim.universal_robots.model import HOME_RAD, MODELS
from sim.world.scene.named_scenes import draw_scene
from sim.world.true_arm import TrueArm
from sim.world.world import ArmState

CYCLE_S = MODELS["ur5e"].cycle_s
SCENE = draw_scene("bench", seed=4, arm=ArmChoice.UR5E)
PARAMETERS = ControllerParameters()
LAG_S = 0.03


class Cell:
    """Drives with their arm, and everything that it has published."""

    def __init__(self, start: tuple[float, ...] = HOME_RAD, last: ArmState | None = None) -> None:
        self.states: list[ArmState] = []
        self.drives = Drives(start, CYCLE_S, PARAMETERS)
        self.arm = ArmInWorld(
            SCENE.arm, SCENE.seed, self.states.append, self.drives, PARAMETERS, CYCLE_S, last
        )

    def turn_base(self, by_rad: float) -> ArmState:
        """Turn the base and return the state at rest."""
        goal = [self.drives.target[0] + by_rad, *self.drives.target[1:]]
        while True:
            self.drives.servo(goal, LAG_S)
            self.arm.follow()
            if self.drives.at_rest:
                return self.states[-1]


def test_the_flange_is_published_where_the_true_arm_has_it() -> None:
    state = Cell().turn_base(0.2)
    true = TrueArm(SCENE.arm, SCENE.seed)
    assert state.at_rest
    assert state.motion_number == 1
    expected = true.at_rest(state.joints_rad, state.flanks, 1, state.moved_s)
    np.testing.assert_array_equal(state.robot_from_flange, expected)


def test_a_resting_arm_publishes_nothing() -> None:
    cell = Cell()
    cell.turn_base(0.1)
    published = len(cell.states)
    for _ in range(10):
        cell.drives.servo(cell.drives.target, LAG_S)
        cell.arm.follow()
    assert len(cell.states) == published


def test_the_same_joints_from_the_other_side_are_another_place_by_the_backlash() -> None:
    cell = Cell()
    cell.turn_base(0.1)
    coming = cell.turn_base(0.1)
    cell.turn_base(0.1)
    returning = cell.turn_base(-0.1)
    assert returning.joints_rad == pytest.approx(coming.joints_rad, abs=1e-12)
    assert (coming.flanks[0], returning.flanks[0]) == (1.0, -1.0)
    away_mm = np.linalg.norm(returning.robot_from_flange[:3, 3] - coming.robot_from_flange[:3, 3])
    assert away_mm > 0.3 * SCENE.arm.backlash_rad[0] * np.linalg.norm(coming.robot_from_flange[:2, 3])


def test_each_motion_has_a_number_and_time_in_motion_adds_up() -> None:
    cell = Cell()
    moved = [cell.turn_base(by) for by in (0.1, -0.1, 0.05)]
    assert [state.motion_number for state in moved] == [1, 2, 3]
    assert moved[0].moved_s < moved[1].moved_s < moved[2].moved_s


def test_an_arm_of_a_continued_world_is_where_it_was() -> None:
    last = Cell().turn_base(0.3)
    state = Cell(last.joints_rad, last).states[-1]
    assert state._replace(robot_from_flange=last.robot_from_flange) == last
    np.testing.assert_array_equal(state.robot_from_flange, last.robot_from_flange)


def test_another_arm_than_the_scenes_is_refused() -> None:
    with raises(BAD_SCENE, match="does not move the scene's arm ur5e"):
        require_arm(SCENE.arm, MODELS["ur5"])
