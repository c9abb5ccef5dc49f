"""How the tape of readings and the journal of a run belong together."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from datetime import datetime
from pathlib import Path

from procedures.engine.context import ClinicalInput
from procedures.journal.journal import ENDS_OF_A_STEP, Entry
from ronna_hw.clock import Clock
from ronna_hw.recording.reading_tape import ReadingTape

BEGINS = (Entry.INTENT, Entry.HOME)


def section_follower(tape: ReadingTape) -> Callable[[bytes], None]:
    """To be handed every line of the journal, by the thread that runs the steps.

    What devices answer to a step, or on the way home, is one section: it has the number of its first line.
    """

    def follow(line: bytes) -> None:
        content = json.loads(line)
        if content["entry"] in BEGINS:
            tape.begin(content["sequence"])
        elif content["entry"] in ENDS_OF_A_STEP:
            tape.end()

    return follow


def opening_line(
    folder: Path,
    theatre_file: Path,
    clock: Clock,
    clinical: ClinicalInput | None,
    began: datetime,
    calibration: Mapping[str, object] | None = None,
) -> dict[str, object]:
    """What a replay must know besides the answers; paths inside the run folder are relative to it.

    `calibration` says of what is no clinical case which steps it had, and the records that were in use.
    """

    def placed(path: Path) -> str:
        inside, whole = folder.resolve(), path.resolve()
        return str(whole.relative_to(inside) if whole.is_relative_to(inside) else whole)

    return {
        "theatre_file": placed(theatre_file),
        "paced": clock.paced,
        "series": None if clinical is None else placed(clinical.series),
        "plan": None if clinical is None else placed(clinical.plan),
        "strategy": None if clinical is None else clinical.strategy.name,
        "measure_targets": clinical is not None and clinical.measure_targets,
        "began": began.isoformat(),
        "calibration": calibration,
    }
