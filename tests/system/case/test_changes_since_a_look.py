"""What changes by little, or where nothing sees it, is found by the look before or after a target."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path
from typing import Any

import pytest
from user_commands import Commands

from procedures.guards.errors import BaseShifted
from procedures.journal.journal import JOURNAL_FILE, Entry, Line, read_journal
from procedures.steps.errors import ToolBesideGauge
from ronna_hw.errors import EXIT_REFUSED

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
MINI = ("--scene", "mini")
SPHERES = range(1, 6)  # of the default scene
LARGEST_ERROR_MM = 0.6  # of these seeds; 0.61 and 0.76 where the cart had crept unnoticed


def run(commands: Commands, folder: Path, faults: str, *case: str) -> subprocess.CompletedProcess[str]:
    script = folder / "faults.txt"
    script.write_text(faults)
    options = ("--faults", str(script), "--out", str(folder / "runs"), "--json")
    return commands.run("ronna-procedure", "run", "--sim", *case, *options, timeout_s=500)


def journal(folder: Path) -> list[Line]:
    (run_folder,) = (folder / "runs").iterdir()
    return list(read_journal(run_folder / JOURNAL_FILE))


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
    commands: Commands, tmp_path: Path, hidden: tuple[str, ...], said: str
) -> None:
    covered = "".join(f"{begins}: tracker occlude marker {one}\n" for begins in hidden for one in SPHERES)
    shifted = "since step == at_target:T1: room shift head 1.8 2.4 0 mm\n"
    ran = run(commands, tmp_path, covered + shifted, "--seed", "3", "--targets", "1")
    lines = journal(tmp_path)
    ((targets, text),) = in_doubt(lines)
    assert targets == ["T1"]
    assert said in text
    assert ran.returncode == EXIT_REFUSED, ran.stderr  # refused on the way, or in doubt at the end


@pytest.mark.hazard(13)
@pytest.mark.parametrize(
    ("case", "shift"),
    [
        (("--seed", "3", "--targets", "1"), "0.39 0.52 0"),  # 0.65 mm
        ((*MINI, "--seed", "7"), "0.486 0.648 0"),  # 0.81 mm
    ],
    ids=["default", "mini"],
)
def test_a_cart_that_crept_is_noticed_before_the_guide_is_led_to_the_head(
    commands: Commands, tmp_path: Path, case: tuple[str, ...], shift: str
) -> None:
    ran = run(commands, tmp_path, f"since step == tool_change: room shift cart {shift} mm\n", *case)
    lines = journal(tmp_path)
    failed = next(line for line in lines if line["entry"] == Entry.FAILED)
    assert failed["code"] == BaseShifted.code
    assert led_to(lines[: lines.index(failed)]) == []
    assert ran.returncode == 0, ran.stderr  # the cart was locked and everything localized again
    assert json.loads(ran.stdout)["max_application_error_mm"] <= LARGEST_ERROR_MM


@pytest.mark.hazard(3)
@pytest.mark.hazard(47)
def test_a_guide_bent_at_the_first_target_is_not_led_to_the_second(
    commands: Commands, tmp_path: Path
) -> None:
    bent = "since step == positioning:T1: room bent tip 1 0 0 mm\n"
    ran = run(commands, tmp_path, bent, *MINI, "--seed", "3", "--targets", "2")
    lines = journal(tmp_path)
    ((targets, text),) = in_doubt(lines)
    assert targets == ["T1"]
    assert re.search(r"the guide is (0\.9|1\.0)\d mm", text)
    assert led_to(lines) == ["T1"]
    assert ran.returncode == ToolBesideGauge.exit_code
    assert ToolBesideGauge.code in ran.stderr
