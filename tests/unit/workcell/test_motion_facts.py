"""What a question says about a motion before it is driven."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import cast

import pytest

from procedures.workcell.motions import MotionFacts
from ronna_hw.arm.preview import PathPreview


@pytest.mark.parametrize(
    ("travel_mm", "turn_deg", "moves", "turns"),
    [(8.3, 0.31, "moves 8 mm", "up to 0.3 deg"), (0.4, 12.2, "moves 0.4 mm", "up to 12 deg")],
)
def test_a_motion_that_would_round_to_nothing_is_told_with_a_decimal(
    travel_mm: float, turn_deg: float, moves: str, turns: str
) -> None:
    turn = (0.0, math.radians(turn_deg))
    preview = SimpleNamespace(
        joint_ranges_rad=[turn],
        duration_s=1.0,
        largest_speed_mm_s=8.0,
        refused=None,
        closest=None,
        nearest_to_head_mm=None,
    )
    facts = MotionFacts("the stereo head", travel_mm, (cast(PathPreview, preview),))
    assert f"the stereo head {moves}, joints turn {turns}, in 1.0 s at up to 8 mm/s" in str(facts)
    assert facts.read_back.shown == moves
    assert facts.read_back.fits(moves.removeprefix("moves "))
