"""The columns of the arm's errors against an independent chain with small perturbations."""

from __future__ import annotations

import numpy as np
import pytest

from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.calibrated_arm.error_budget import (
    JOINT_OFFSET_RAD,
    LINK_ROTATION_RAD,
    LINK_TRANSLATION_MM,
    error_columns,
)
from sim.world.nominal_arm import description
from sim.world.scene.model import LinkError
from sim.world.true_arm import JointChain

VARIANT = "kr6_r900_sixx"
JOINTS = (0.3, -1.2, 1.6, 0.4, 1.0, 2.5)
IN_FLANGE_MM = np.array([60.0, -20.0, 220.0, 1.0])
COLUMNS_PER_JOINT = 11  # offset, two harmonics of two phases, three pairs of shift and turn
SMALL = 1e-3


def ball_with(links: list[LinkError], joints=JOINTS):
    return (JointChain(description(VARIANT), links).flange(joints) @ IN_FLANGE_MM)[:3]


def exact() -> list[LinkError]:
    return [LinkError(translation_mm=(0.0, 0.0, 0.0), rotation_rad=(0.0, 0.0, 0.0))] * 6


@pytest.fixture
def columns():
    return error_columns(kr6_r900(VARIANT).chain, [JOINTS], ball_with(exact()))[0]


@pytest.mark.parametrize("link", range(5))  # the flange is turned against the last link's end: see below
@pytest.mark.parametrize("axis", range(3))
def test_a_link_error_moves_the_ball_as_its_columns_predict(columns, link: int, axis: int) -> None:
    first = COLUMNS_PER_JOINT * link + 5 + 2 * axis
    for turns, size, column in ((False, LINK_TRANSLATION_MM, first), (True, LINK_ROTATION_RAD, first + 1)):
        error = [0.0, 0.0, 0.0]
        error[axis] = SMALL * size
        links = exact()
        links[link] = LinkError(
            translation_mm=(0.0, 0.0, 0.0) if turns else tuple(error),
            rotation_rad=tuple(error) if turns else (0.0, 0.0, 0.0),
        )
        moved = (ball_with(links) - ball_with(exact())) / SMALL
        assert columns[:, column] == pytest.approx(moved, abs=1e-3)


def test_an_error_of_the_last_link_moves_the_ball_by_its_size(columns) -> None:
    shifts = columns[:, COLUMNS_PER_JOINT * 5 + 5 :: 2]
    assert np.linalg.norm(shifts, axis=0) == pytest.approx([LINK_TRANSLATION_MM] * 3)


@pytest.mark.parametrize("joint", range(6))
def test_a_joint_offset_moves_the_ball_as_its_column_predicts(columns, joint: int) -> None:
    joints = list(JOINTS)
    joints[joint] += SMALL * JOINT_OFFSET_RAD
    moved = (ball_with(exact(), tuple(joints)) - ball_with(exact())) / SMALL
    assert columns[:, COLUMNS_PER_JOINT * joint] == pytest.approx(moved, abs=1e-3)
