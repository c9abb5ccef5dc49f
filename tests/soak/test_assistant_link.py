"""The link to the assistant is cut once in every step of a case with two arms.

The case goes on, or stops with the error of that link and is resumed to its target, with the link opened
anew.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import pytest
from disturbed_steps import disturb_every_step
from running_case import RunningCase
from user_commands import Commands

pytestmark = [pytest.mark.soak, pytest.mark.timeout(3600), pytest.mark.hazard(58)]

MINI = ("--scene", "mini", "--seed", "3", "--dual")
UR = ("--assistant-arm", "ur5e")
LARGEST_ERROR_MM = 1.5


class Cut(NamedTuple):
    """A fault of the link, the codes with which a case may stop for it, and options of the case."""

    fault: str
    codes: str
    arms: tuple[str, ...] = ()


CUTS = (
    Cut("assistant robot eki cut", "DUAL-00[13]|EKI-0..|RSI-0.."),
    Cut("assistant robot network cut for 2 s", "DUAL-00[13]|EKI-0..|RSI-0.."),
    Cut("assistant ur cut connections", "DUAL-00[13]|URD-0..", UR),
    Cut("assistant ur cable pulled for 2 s", "DUAL-00[13]|URD-0..", UR),
)


@pytest.mark.parametrize("cut", CUTS, ids=lambda cut: cut.fault)
def test_a_case_whose_assistant_loses_its_link_in_every_step_goes_on_or_says_so_and_is_resumed(
    commands: Commands, tmp_path: Path, cut: Cut
) -> None:
    case = RunningCase(commands, (*MINI, *cut.arms), tmp_path / "runs")
    outcome = disturb_every_step(case, lambda case: case.inject(cut.fault), cut.codes)
    assert outcome["max_application_error_mm"] <= LARGEST_ERROR_MM
