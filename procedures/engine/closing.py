"""The last line of a run: how it ended, and the hashes of its files and inputs."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from procedures.engine.context import ClinicalInput
from procedures.journal.errors import JournalNotWritable
from procedures.journal.journal import Entry, Journal, JournalValue
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.journal_reading import JOURNAL_FILE, read_chain
from ronna_hw.evidence.manifest import hashes_at_closing, hashes_outside, keep_earlier_hashes, not_vouched_for
from ronna_hw.logs import logger

_log = logger(part="engine")


class Recorder(Protocol):
    """Writes files of the run alongside the engine."""

    def close(self) -> None:
        """Write what is left and close the files. Bounded in time; never raises."""
        ...


def close_run(
    folder: Path,
    journal: Journal,
    theatre_time_s: float,
    outcome: str,
    clinical: ClinicalInput | None,
    **more: JournalValue,
) -> None:
    """Write the journal's last line and close it; whatever prevents that is reported by `verify`."""
    try:
        evidence = _evidence(folder, clinical)
        journal.write(Entry.CLOSED, theatre_time_s, outcome=outcome, **more, **evidence)
    except JournalNotWritable:
        pass  # it has been reported where it broke; closing must go on
    finally:
        journal.close()


def _evidence(folder: Path, clinical: ClinicalInput | None) -> dict[str, JournalValue]:
    """Hashes of the run's files, and of CT, plan and proposed place where they are not in its folder."""
    inputs = () if clinical is None else (clinical.series, clinical.plan, clinical.place)
    try:
        expected = not_vouched_for(read_chain(folder / JOURNAL_FILE).lines)
        hashes = keep_earlier_hashes(hashes_at_closing(folder) | hashes_outside(folder, inputs), expected)
    except (OSError, RonnaError) as error:  # closing must go on; verify says that the files are not named
        _log.error("files not hashed", error=str(error))
        return {}
    inputs_there = {name: sha256 for name, sha256 in hashes.items() if Path(name).is_absolute()}
    files = {name: sha256 for name, sha256 in hashes.items() if name not in inputs_there}
    found: dict[str, JournalValue] = {"files": files}
    return found | ({"inputs": inputs_there} if inputs_there else {})
