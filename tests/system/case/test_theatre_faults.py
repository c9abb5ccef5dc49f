"""Errors with hands, tools, screws and the cart: each with its promised outcome."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from simulated_case import SimulatedCase
from user_commands import Commands

from procedures.journal.journal import Line
from procedures.steps.clinical.tool_check import APPROACHES
from ronna_hw.calibration import Numbers3
from ronna_hw.errors import EXIT_REFUSED
from sim.world.truth import THEATRE_FOLDER, read_samples

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]
MINI = ("--scene", "mini", "--seed", "3")


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
    unpushed = SimulatedCase(Commands(), tmp_path_factory.mktemp("unpushed"))
    unpushed.run(*MINI)
    return instrument_tip_mm(unpushed.run_folder)


@pytest.mark.hazard(45)
@pytest.mark.hazard(46)
@pytest.mark.hazard(47)
@pytest.mark.parametrize("what", FAULTS)
def test_a_scripted_fault_ends_as_promised(case: SimulatedCase, unpushed_mm: Numbers3, what: str) -> None:
    promise = FAULTS[what]
    ran = case.run(*MINI, *promise.options, faults=f"since step == {promise.step}: room {promise.fault}")
    assert ran.returncode == (EXIT_REFUSED if promise.code and not promise.goes_on else 0), ran.stderr
    judge(promise, case.journal, case.run_folder, unpushed_mm)


@pytest.mark.hazard(47)
@pytest.mark.parametrize(("seat", "code"), [("2 mm 0 deg", "TOOL-006"), ("0.1 mm 0 deg", "TOOL-005")])
def test_the_tracker_measures_the_guide_before_it_goes_to_the_gauge(
    case: SimulatedCase, seat: str, code: str
) -> None:
    ran = case.run(*MINI, faults=f"when step == tool_change: room bad seat {seat}")
    assert ran.returncode == EXIT_REFUSED
    assert code in ran.stderr
    works = [line["task"] for line in case.journal if line["entry"] == "work"]
    twice_all = 2 * 2 * APPROACHES  # what differs is read as often again; it was mounted twice
    assert works.count("gauge") == (twice_all if code == "TOOL-005" else 0)
