"""Every fault of the three devices in every step in which it can happen, on the mini scene.

A cell passes when the case ends as promised: at its target, or with one of the codes of that fault, in time.
A case that failed moved nothing after the failure unless the operator led it on, its journal is whole, and no
process is left.
"""

import json
import re
from datetime import datetime
from pathlib import Path

import pytest
from single_faults import FAULTS, STEPS, stops
from user_commands import Commands

from procedures.journal.journal import JOURNAL_FILE, Entry, Line, read_journal

pytestmark = [pytest.mark.soak, pytest.mark.timeout(300)]

LARGEST_ERROR_MM = 1.5
WITHIN_S = 150.0  # host time for a whole case, on a busy computer
# Host time from the step in which the fault begins to the failure: theatre time runs free in lock-step
# while a link is silent.
SETTLED_S = 30.0
DONE = "done"
CODE = re.compile(r"[A-Z]+-\d{3}")
QUOTING = {"PRO-001", "DEV-001"}  # a step, or a call in it, that came after the fault and is refused for it
CELLS = [
    (f"when step == {step}: {device} {fault}", frozenset(codes))
    for device, faults in FAULTS
    for fault, codes in faults.items()
    for step in STEPS[device]
]


def test_the_matrix_has_at_least_three_hundred_cells() -> None:
    assert len(CELLS) >= 300


def host_time(line: Line) -> datetime:
    return datetime.fromisoformat(str(line["host_time"]))


def codes_told(stop: Line, outcome_code: str) -> set[str]:
    """The code of the stop; where something was refused because of a fault, also the codes that it quotes."""
    code = str(stop.get("code", outcome_code))
    return {code, *CODE.findall(str(stop.get("unmet", stop.get("what"))))} if code in QUOTING else {code}


@pytest.mark.parametrize(("line", "codes"), CELLS, ids=[line for line, _ in CELLS])
def test_a_case_with_a_fault_ends_as_promised(
    commands: Commands, tmp_path: Path, line: str, codes: frozenset[str]
) -> None:
    script = tmp_path / "faults.txt"
    script.write_text(line + "\n")
    case = ("--scene", "mini", "--seed", "3", "--faults", str(script), "--out", str(tmp_path / "runs"))
    ended = commands.run("ronna-procedure", "run", "--sim", *case, "--json", timeout_s=WITHIN_S)
    outcome = json.loads(ended.stdout)
    journal = list(read_journal(tmp_path / "runs" / outcome["run"] / JOURNAL_FILE))
    assert journal[-1]["entry"] == Entry.CLOSED
    if outcome["outcome"] == DONE:
        assert outcome["max_application_error_mm"] <= LARGEST_ERROR_MM
        return
    stretches = list(stops(journal))
    stop = stretches[0][0]
    assert codes_told(stop, outcome["error"]["code"]) & codes, ended.stderr
    assert all(entry["entry"] != Entry.MOTION for stretch in stretches for entry in stretch)
    step = line.removeprefix("when step == ").partition(":")[0]
    begun = next(entry for entry in journal if str(entry.get("step")).partition(":")[0] == step)
    assert (host_time(stop) - host_time(begun)).total_seconds() <= SETTLED_S
