"""Mean times of phases and steps over several runs, compared with the thesis' times."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import fmean

from procedures.journal.journal import JOURNAL_FILE, read_journal
from procedures.reporting.run_statistics import (
    ALGORITHM_PROCESSOR,
    ALGORITHM_S,
    LOCALIZATION,
    OPERATOR_S,
    PHASE,
    STEP,
    TimeTaken,
    times_taken,
)
from studies.campaign.study import Table
from studies.errors import NO_RUN_TO_TIME


def time_tables(runs: Sequence[Path]) -> tuple[Table, Table]:
    """Tabulate the mean times of several runs, and the CT localization times next to the thesis'.

    Raises the errors of an unreadable journal.
    """
    for run in runs:
        if not (run / JOURNAL_FILE).is_file():
            raise NO_RUN_TO_TIME(f"{run} has no journal", expected="the folder of a run")
    journals = [tuple(read_journal(run / JOURNAL_FILE)) for run in runs]
    each = [times_taken(journal) for journal in journals]
    keys = dict.fromkeys((one.kind, one.name) for times in each for one in times)
    rows = []
    for kind, name in keys:
        there = [one for times in each for one in times if (one.kind, one.name) == (kind, name)]
        host = [one.host_s for one in there if one.host_s is not None]
        rows.append(
            (
                kind,
                name,
                round(sum(one.count for one in there) / len(each), 2),
                round(sum(one.theatre_s for one in there) / len(each), 2),
                round(sum(host) / len(each), 2) if kind in (PHASE, STEP) else None,
            )
        )
    columns = ("what", "name", "times in a run", "theatre s in a run", "computer s in a run")
    processors = dict.fromkeys(
        str(journal[0].get("processor", "not recorded")) for journal in journals if journal
    )
    return Table("Times", columns, tuple(rows)), _compare_with_thesis(each, ", ".join(processors))


def _compare_with_thesis(each: Sequence[Sequence[TimeTaken]], processors: str) -> Table:
    here = [one.host_s for times in each for one in times if one.name == LOCALIZATION and one.host_s]
    return Table(
        "Markers in the CT, seconds",
        ("thesis, operator", f"thesis, algorithm, {ALGORITHM_PROCESSOR}", f"here, {processors}"),
        ((OPERATOR_S, ALGORITHM_S, round(fmean(here), 1) if here else None),),
    )
