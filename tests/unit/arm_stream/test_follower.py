"""Supervision of a motion: in the words of the arm that was found, and one motion at a time."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import pytest
from watched_stream import Watched, watched_ur

from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arm.motion.planning import MotionPlan
from ronna_hw.arm.motion.progress import PathLimits
from ronna_hw.arm_stream.motion import MotionFollower
from ronna_hw.arm_stream.records import LinkState, MotionResult
from ronna_hw.devices.errors import MotionInterrupted
from ronna_hw.errors import RefusedError

PLAN = MotionPlan((0.0,) * 6, (0.1,) * 6, PathLimits(0.1, 0.2, 0.3))


def follower_of(watched: Watched) -> MotionFollower[Any]:
    watched.link.state = replace(
        watched.link.state, command_number=1, result=MotionResult.STOPPED, moving=False
    )
    return MotionFollower(watched.connections, watched.watch, 0.002)


def test_an_arm_that_is_found_later_is_taken_over() -> None:
    watched = watched_ur()
    follower = follower_of(watched)
    for arm in (watched.connections.faults.arm, kr6_r900("kr6_r900_sixx")):
        watched.connections.faults = replace(watched.connections.faults, arm=arm)
        with pytest.raises(MotionInterrupted) as stopped:
            follower.follow(PLAN, 0, 1.0)
        assert str(stopped.value.got).startswith(f"{arm.axis_names[0]}..{arm.axis_names[-1]} ")


def test_a_second_motion_is_refused_while_one_is_followed() -> None:
    watched = watched_ur()
    follower = follower_of(watched)
    refusals = []

    def move_again(*_wait: object) -> LinkState:
        with pytest.raises(RefusedError, match="another motion is running") as refused:
            follower.follow(PLAN, 0, 1.0)
        refusals.append(refused.value.code)
        return watched.link.state

    watched.link.wait = cast(Any, move_again)  # type: ignore[method-assign]
    with pytest.raises(MotionInterrupted):
        follower.follow(PLAN, 0, 1.0)
    assert refusals == ["URD-034"]
