"""Errors with hands, tools, screws and the cart: scripted and live, each with its promised outcome."""

from __future__ import annotations

import json
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from user_commands import Commands

from procedures.journal.journal import JOURNAL_FILE, Line, read_journal
from procedures.steps.clinical.tool_check import APPROACHES
from ronna_hw.calibration import Numbers3
from ronna_hw.control_port import ask_control_port
from ronna_hw.errors import EXIT_REFUSED
from sim.world.truth import THEATRE_FOLDER, read_samples

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]
MINI = ("--sim", "--scene", "mini", "--seed", "3")
CONTROL = re.compile(r"control port (\S+)")


@dataclass(frozen=True)
class Promise:
    """What a fault of a step promises: an error, or how far the guide was pushed."""

    fault: str
    step: str
    code: str = ""
    pushed_mm: float = 0.0
    goes_on: bool = False  # the rehearsal's script agrees to what is proposed, and the case is completed
    options: tuple[str, ...] = ()  # of the case


HAND_MM = 10.0 / 80.0  # ten newtons on the stiffness of the scene
# Of the tracker, in 998 of 1,000 insertions: after four stages the largest displacement counts.
NOISE_MM = (-0.025, 0.09)
FAULTS = {
    "a hand load of 10 N": Promise("push guide 0 10 0 N", "at_target", pushed_mm=HAND_MM),
    "the surgeon pulling the guide": Promise("push guide 0 -30 -26 N", "at_target", "PRO-017"),
    "a hand that turns the wrist": Promise("turn guide 0 0.3 0 deg", "at_target", "PRO-017"),
    "a bent tip": Promise("bent tip 0.07 0.07 0 mm", "tool_check", "TOOL-005"),
    "a wrong mandrel": Promise("wrong mandrel 2 mm", "tool_check", "TOOL-005"),
    "a badly seated changer": Promise("bad seat 0.1 mm 0.2 deg", "tool_check", "TOOL-005"),
    "a wrong load": Promise("wrong load 1 kg", "tool_check", "TOOL-005"),
    "a depth stop set wrong": Promise("depth stop off by 2 mm", "at_target", "TOOL-004"),
    "a cart move": Promise("shift cart 0 2 0 mm", "positioning", "PRO-019", goes_on=True),
    "a loosened screw": Promise(
        "loosen marker 2 1.2 -0.9 0 mm", "relocalization", "PRO-020", options=("--markers", "5")
    ),
}
BEFORE = {
    "relocalization": "path_check",
    "tool_check": "tool_change",
    "positioning": "tool_check",
    "at_target": "positioning:T1",
}


def judge(promise: Promise, lines: list[Line], folder: Path, unpushed_mm: Numbers3) -> None:
    """The step ended as promised; an instrument is in only where it was when the guide was pulled."""
    of_step = [line for line in lines if str(line.get("step", "")).partition(":")[0] == promise.step]
    if promise.code:
        failed = next(number for number, line in enumerate(lines) if line["entry"] == "failed")
        assert [line.get("code") for line in of_step if line["entry"] == "failed"] == [promise.code]
        assert not [line for line in lines[:failed] if line.get("topic") == "skin:T1"]
        if promise.step == "positioning":
            (voided,) = (line for line in lines if line["entry"] == "voided")
            assert voided["step"] == "cart_lock"
        return
    (done,) = (line for line in of_step if line["entry"] == "result")
    record = json.loads((folder / "records" / f"{done['record']}.json").read_text())
    lowest_mm, highest_mm = NOISE_MM
    assert lowest_mm < record["payload"]["pushed_mm"] - promise.pushed_mm < highest_mm
    moved_mm = np.subtract(instrument_tip_mm(folder), unpushed_mm)
    assert moved_mm == pytest.approx((0.0, promise.pushed_mm, 0.0), abs=1e-3)


def instrument_tip_mm(folder: Path) -> Numbers3:
    """Truth at the only target of a run."""
    (sample,) = read_samples(folder / THEATRE_FOLDER)
    return sample.tip_mm


@pytest.fixture(scope="module")
def unpushed_mm(tmp_path_factory: pytest.TempPathFactory) -> Numbers3:
    """Truth of the same case without a fault."""
    runs = tmp_path_factory.mktemp("unpushed")
    Commands().run("ronna-procedure", "run", *MINI, "--out", str(runs), timeout_s=200)
    (folder,) = runs.iterdir()
    return instrument_tip_mm(folder)


@pytest.mark.hazard(45)
@pytest.mark.hazard(46)
@pytest.mark.hazard(47)
@pytest.mark.parametrize("what", FAULTS)
def test_a_scripted_fault_ends_as_promised(
    commands: Commands, tmp_path: Path, unpushed_mm: Numbers3, what: str
) -> None:
    promise = FAULTS[what]
    faults = tmp_path / "faults.txt"
    faults.write_text(f"since step == {promise.step}: room {promise.fault}\n")
    options = (*promise.options, "--faults", str(faults), "--out", str(tmp_path / "runs"), "--json")
    ran = commands.run("ronna-procedure", "run", *MINI, *options, timeout_s=200)
    assert ran.returncode == (EXIT_REFUSED if promise.code and not promise.goes_on else 0), ran.stderr
    (folder,) = (tmp_path / "runs").iterdir()
    judge(promise, list(read_journal(folder / JOURNAL_FILE)), folder, unpushed_mm)


@pytest.mark.hazard(46)
@pytest.mark.parametrize("what", FAULTS)
def test_a_live_fault_ends_as_promised(
    commands: Commands, tmp_path: Path, unpushed_mm: Numbers3, what: str
) -> None:
    promise = FAULTS[what]
    before = BEFORE[promise.step]
    step = promise.step if promise.step == "tool_check" else f"{promise.step}:T1"
    options = (*promise.options, "--out", str(tmp_path / "runs"))
    stepping = commands.start("ronna-procedure", "step", *MINI, *options, stdin=subprocess.PIPE)
    assert stepping.stdin is not None
    assert stepping.stdout is not None
    assert stepping.stderr is not None
    stepping.stdin.write(f"to {before}\n")
    stepping.stdin.flush()
    control = next(found for line in stepping.stderr if (found := CONTROL.search(line)))
    assert any(line.startswith(f"done {before}") for line in stepping.stdout)
    ask_control_port(control[1], "fault", line=f"now: room {promise.fault}")
    stepping.communicate(f"run {step}\nhome\nquit\n", timeout=100)
    (folder,) = (tmp_path / "runs").iterdir()
    judge(promise, list(read_journal(folder / JOURNAL_FILE)), folder, unpushed_mm)


@pytest.mark.hazard(47)
@pytest.mark.parametrize(("seat", "code"), [("2 mm 0 deg", "TOOL-006"), ("0.1 mm 0 deg", "TOOL-005")])
def test_the_tracker_measures_the_guide_before_it_goes_to_the_gauge(
    commands: Commands, tmp_path: Path, seat: str, code: str
) -> None:
    faults = tmp_path / "faults.txt"
    faults.write_text(f"when step == tool_check: room bad seat {seat}\n")
    options = ("--faults", str(faults), "--out", str(tmp_path / "runs"))
    ran = commands.run("ronna-procedure", "run", *MINI, *options, timeout_s=200)
    assert ran.returncode == EXIT_REFUSED
    assert code in ran.stderr
    (folder,) = (tmp_path / "runs").iterdir()
    works = [line["task"] for line in read_journal(folder / JOURNAL_FILE) if line["entry"] == "work"]
    twice_all = 2 * 2 * APPROACHES  # what differs is read as often again; it was mounted twice
    assert works.count("gauge") == (twice_all if code == "TOOL-005" else 0)
