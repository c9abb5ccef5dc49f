"""What changes by little, or where nothing sees it, is found by the look before or after a target."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest
from simulated_case import SimulatedCase

from procedures.guards.errors import BaseShifted
from procedures.journal.journal import Entry, Line
from procedures.steps.errors import ToolBesideGauge
from ronna_hw.errors import EXIT_REFUSED

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
MINI = ("--scene", "mini")
SPHERES = range(1, 6)  # of the default scene
LARGEST_ERROR_MM = 0.6  # of these seeds; 0.61 and 0.76 where the cart had crept unnoticed


def in_doubt(lines: list[Line]) -> list[tuple[list[str], str]]:
    """The findings that name targets: these, and the text."""
    found = [line for line in lines if line["entry"] == Entry.FINDING and line.get("targets")]
    return [(list(line["targets"]), str(line["text"])) for line in found]


def led_to(lines: list[Line]) -> list[Any]:
    """The targets that the guide was led to along their axes."""
    return [line["trajectory"] for line in lines if line.get("what") == "insert"]


@pytest.mark.hazard(12)
@pytest.mark.parametrize(
    ("hidden", "said"),
    [
        (("when step == at_target:T1",), "the head has moved"),  # seen on the way out
        (("when step == at_target:T1", "when step == retreat:T1"), "the head has moved"),
        (("since step == at_target:T1",), "the tracker does not see the head"),
    ],
    ids=["hidden in the last hold", "hidden until the arm is home", "hidden from then on"],
)
def test_a_head_that_moves_while_hidden_at_the_last_target_is_a_finding_on_it(
    case: SimulatedCase, hidden: tuple[str, ...], said: str
) -> None:
    covered = "".join(f"{begins}: tracker occlude marker {one}\n" for begins in hidden for one in SPHERES)
    shifted = "since step == at_target:T1: room shift head 1.8 2.4 0 mm\n"
    ran = case.run("--seed", "3", "--targets", "1", faults=covered + shifted)
    lines = case.journal
    ((targets, text),) = in_doubt(lines)
    assert targets == ["T1"]
    assert said in text
    assert ran.returncode == EXIT_REFUSED, ran.stderr  # refused on the way, or in doubt at the end


@pytest.mark.hazard(13)
@pytest.mark.parametrize(
    ("scene", "shift"),
    [
        (("--seed", "3", "--targets", "1"), "0.39 0.52 0"),  # 0.65 mm
        ((*MINI, "--seed", "7"), "0.486 0.648 0"),  # 0.81 mm
    ],
    ids=["default", "mini"],
)
def test_a_cart_that_crept_is_noticed_before_the_guide_is_led_to_the_head(
    case: SimulatedCase, scene: tuple[str, ...], shift: str
) -> None:
    ran = case.run(*scene, faults=f"since step == tool_change: room shift cart {shift} mm")
    lines = case.journal
    failed = next(line for line in lines if line["entry"] == Entry.FAILED)
    assert failed["code"] == BaseShifted.code
    assert led_to(lines[: lines.index(failed)]) == []
    assert ran.returncode == 0, ran.stderr  # the cart was locked and everything localized again
    assert json.loads(ran.stdout)["max_application_error_mm"] <= LARGEST_ERROR_MM


@pytest.mark.hazard(3)
@pytest.mark.hazard(47)
def test_a_guide_bent_at_the_first_target_is_not_led_to_the_second(case: SimulatedCase) -> None:
    bent = "since step == positioning:T1: room bent tip 1 0 0 mm"
    ran = case.run(*MINI, "--seed", "3", "--targets", "2", faults=bent)
    lines = case.journal
    ((targets, text),) = in_doubt(lines)
    assert targets == ["T1"]
    assert re.search(r"the guide is (0\.9|1\.0)\d mm", text)
    assert led_to(lines) == ["T1"]
    assert ran.returncode == ToolBesideGauge.exit_code
    assert ToolBesideGauge.code in ran.stderr
