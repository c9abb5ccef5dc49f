"""A case that is disturbed once in every step, and resumed each time that it stops for it."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from running_case import RunningCase
from single_faults import COMPUTED, DONE

FEWEST_STEPS = 5  # of a case in which something moves: with fewer, what was to be disturbed was not found


def disturb_every_step(
    case: RunningCase, disturb: Callable[[RunningCase], bool], codes: str
) -> dict[str, Any]:
    """Disturb every step as soon as that is possible, resume the case whenever it stops, return its outcome.

    A step that only computes is left out: the next one meets what happens in it. `disturb` tells whether it
    was possible; of the codes of each stop one must match `codes`, a pattern.
    """
    disturbed: list[str] = []
    stops = 0

    def is_disturbed() -> bool:
        step = case.step
        if step in disturbed or step.partition(":")[0] in ("", *COMPUTED) or not disturb(case):
            return False
        disturbed.append(step)
        return True

    while True:
        before = len(disturbed)
        case.eventually(is_disturbed)
        if len(disturbed) > before:
            continue
        outcome = case.end()
        if outcome["outcome"] == DONE:
            assert len(disturbed) >= FEWEST_STEPS, disturbed
            return outcome
        stops += 1
        assert stops <= len(disturbed), f"stopped again without another disturbance: {case.codes}"
        assert any(re.fullmatch(codes, one) for one in case.codes), f"{disturbed[-1]}: {case.codes}"
        case.resume()
