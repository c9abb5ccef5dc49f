"""Every cell of the table of single faults: a case on the mini scene in which one thing goes wrong.

A cell passes when the case ends as the table says, in time. A case that failed moved nothing after the
failure unless the operator led it on, its journal is whole, and no process is left.
"""

import json
from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest
from simulated_case import SimulatedCase
from single_faults import DONE, SCENES, Cell, cells, codes_told, noticed_by_device, stops
from user_commands import Commands

from procedures.journal.journal import Entry, Line
from procedures.workcell.arms import HALTED
from ronna_hw.log_output import LOG_FILE
from sim.world.scene.named_scenes import draw_scene

pytestmark = [pytest.mark.soak, pytest.mark.timeout(400)]

SEED = 3
LARGEST_ERROR_MM = 1.5
IN_DOUBT = "in doubt"
AT_REST = (Entry.RESTED, Entry.FAILED, Entry.REFUSED)


@pytest.mark.parametrize("cell", cells(), ids=lambda cell: cell.name)
def test_a_case_with_a_fault_ends_as_promised(commands: Commands, tmp_path: Path, cell: Cell) -> None:
    case, row = SimulatedCase(commands, tmp_path), cell.row
    words, scene = ("--scene", "mini", "--seed", str(SEED), "--markers", str(row.markers)), None
    if row.scene:
        words, scene = (), SCENES[row.scene](draw_scene("mini", seed=SEED, markers=row.markers))
    answers = row.answers and f"[answers]\n{row.answers}"
    ended = case.run(*words, *row.arms, scene=scene, faults=cell.line, answers=answers)
    outcome = json.loads(ended.stdout)
    promised = broken_promises(cell, outcome, case.journal, halted_s(case.run_folder))
    assert list(promised) == [], ended.stderr


def halted_s(run: Path) -> float | None:
    """Theatre time at which both arms were halted together, if they were.

    The case ends when the driver knows why: power that goes off stops a program first. It awaits that for
    half a second of the host, in which theatre time runs free.
    """
    lines = map(json.loads, (run / LOG_FILE).read_text().splitlines())
    return next((line["theatre_time_s"] for line in lines if line.get("event") == HALTED), None)


def broken_promises(
    cell: Cell, outcome: dict[str, Any], journal: Sequence[Line], halted_s: float | None
) -> Iterator[str]:
    """What the case did otherwise than its row of the table says."""
    if journal[-1]["entry"] != Entry.CLOSED:
        yield "the journal is not closed"
    asked = {str(line["topic"]).partition(":")[0] for line in journal if line["entry"] == Entry.CONFIRMATION}
    if cell.row.asks is not None and cell.row.asks not in asked:
        yield f"nobody was asked {cell.row.asks}"
    stretches = list(stops(journal))
    if any(line["entry"] == Entry.MOTION for stretch in stretches for line in stretch):
        yield "something moved after the stop"
    if outcome["outcome"] == (IN_DOUBT if cell.row.in_doubt else DONE):
        if not cell.may_be_done:
            yield "the case went on"
        if outcome["max_application_error_mm"] > LARGEST_ERROR_MM:
            yield f"{outcome['max_application_error_mm']} mm beside its target"
    elif not stretches:
        yield f"ended as {outcome['outcome']} without a stop"
    if stretches:
        said = codes_told(stretches[0][0])
        if not (as_promised := said & cell.codes):
            yield f"stopped with {', '.join(said)}"
        else:
            yield from too_late(cell, journal, as_promised, halted_s)


def too_late(cell: Cell, journal: Sequence[Line], codes: set[str], halted_s: float | None) -> Iterator[str]:
    """Whether the case came to rest later than promised, on the clock of what noticed the fault."""
    at = next(number for number, line in enumerate(journal) if step_of(line) == cell.step)
    begun, rest = journal[at], next(line for line in journal[at:] if line["entry"] in AT_REST)
    by_device = rest["entry"] != Entry.RESTED and noticed_by_device(codes)
    clock, limit_s = ("host", cell.row.host_s) if by_device else ("theatre", cell.row.theatre_s)
    begins_s = theatre_s(begun) + cell.row.after_s
    took_s = host_s(rest) - host_s(begun) if by_device else (halted_s or theatre_s(rest)) - begins_s
    if limit_s is None or took_s > limit_s:
        yield f"at rest after {took_s:.1f} s of the {clock}, promised {limit_s} s"


def step_of(line: Line) -> str:
    return str(line.get("step")).partition(":")[0]


def host_s(line: Line) -> float:
    return datetime.fromisoformat(str(line["host_time"])).timestamp()


def theatre_s(line: Line) -> float:
    return float(str(line["theatre_time_s"]))
