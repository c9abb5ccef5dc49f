"""Spans, times and link counters of a run, from its journal and log."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from coded_errors import raises

from procedures.journal.journal import Entry, Journal, JournalValue, Line, read_journal
from procedures.reporting.run_statistics import (
    HANDS,
    PHASE,
    QUESTION,
    STEP,
    TimeTaken,
    link_counters,
    timeline,
    times_taken,
)
from studies.errors import NO_RUN_TO_TIME
from studies.times import ALGORITHM_S, OPERATOR_S, time_tables


def line(entry: Entry, time_s: float, **more: JournalValue) -> Line:
    return {"entry": entry.value, "theatre_time_s": time_s, **more}


def test_what_a_killed_program_had_begun_ends_with_its_last_line() -> None:
    spans = timeline(
        [
            line(Entry.OPENED, 0.0),
            line(Entry.INTENT, 1.0, step="set_up"),
            line(Entry.RESULT, 2.0),
            line(Entry.INTENT, 3.0, step="relocalization"),
            line(Entry.MOTION, 4.0, number=1, what="go"),
            line(Entry.RESTED, 5.0, state="suspended", reason="robot link"),
            line(Entry.CONFIRMATION, 6.0),
            line(Entry.RESTARTED, 60.0),
            line(Entry.MOTION, 61.0, number=2, what="home"),
            line(Entry.MOVED, 62.0, number=2),
            line(Entry.INTENT, 63.0, step="relocalization"),
        ]
    )
    assert [(span.name.partition(":")[0], span.row, span.end_s, span.ended) for span in spans] == [
        ("set_up", "set_up", 2.0, "done"),
        ("relocalization", "relocalization", 6.0, "interrupted"),
        ("go", "relocalization", 6.0, "interrupted"),
        ("suspended", "relocalization", 6.0, "interrupted"),
        ("home", "between steps", 62.0, "done"),
        ("relocalization", "relocalization", 63.0, "not ended"),
    ]


@pytest.fixture
def run(tmp_path: Path) -> Path:
    journal = Journal(tmp_path)
    journal.write(Entry.INTENT, 10.0, step="fiducial_localization")
    journal.write(Entry.RESULT, 14.0, step="fiducial_localization")
    for trajectory, began_s in (("T1", 20.0), ("T2", 50.0)):
        journal.write(Entry.INTENT, began_s, step=f"at_target:{trajectory}")
        journal.write(Entry.WORK, began_s + 9.0, task="skin", began_s=began_s + 1.0, readings=[])
        journal.write(Entry.CONFIRMATION, began_s + 12.0, topic=f"skin:{trajectory}", asked_s=began_s + 9.0)
        journal.write(Entry.RESULT, began_s + 15.0, step=f"at_target:{trajectory}")
    journal.write(Entry.INTENT, 70.0, step="retreat:T2")
    journal.write(Entry.CONFIRMATION, 71.0, topic="retreat:T2")  # as earlier versions wrote it
    journal.close()
    return tmp_path


def test_times_of_steps_and_people_are_summed_over_the_trajectories(run: Path) -> None:
    times = {(one.kind, one.name): one for one in times_taken(tuple(read_journal(run / "journal.jsonl")))}
    seconds = {key: (one.count, one.theatre_s) for key, one in times.items()}
    assert seconds == {
        (PHASE, "preoperative"): (1, 4.0),
        (PHASE, "operation"): (3, 31.0),
        (STEP, "fiducial_localization"): (1, 4.0),
        (STEP, "at_target"): (2, 30.0),
        (STEP, "retreat"): (1, 1.0),  # to the last line: nothing ended it
        (QUESTION, "skin"): (2, 6.0),
        (QUESTION, "retreat"): (1, 0.0),
        (HANDS, "skin"): (2, 16.0),
    }
    assert times[QUESTION, "skin"] == TimeTaken(QUESTION, "skin", 2, 6.0, None)


def test_a_step_cut_off_by_a_kill_counts_until_the_last_line_of_its_session(tmp_path: Path) -> None:
    journal = Journal(tmp_path)
    journal.write(Entry.INTENT, 1200.0, step="coarse_alignment")
    journal.write(Entry.FINDING, 1203.0, finding="slow")
    journal.write(Entry.RESTARTED, 1.0)  # another session: its clock begins again
    journal.write(Entry.INTENT, 40.0, step="coarse_alignment")
    journal.write(Entry.RESULT, 50.0, step="coarse_alignment")
    journal.close()
    times = times_taken(tuple(read_journal(tmp_path / "journal.jsonl")))
    assert [(one.count, one.theatre_s) for one in times] == [(2, 13.0), (2, 13.0)]  # the phase and the step


def test_a_campaign_shows_its_times_next_to_those_of_the_thesis(run: Path) -> None:
    times, beside = time_tables([run, run])
    assert ("step", "at_target", 2.0, 30.0) in [tuple(row[:4]) for row in times.rows]
    assert beside.rows[0][:2] == (OPERATOR_S, ALGORITHM_S)


def test_times_name_the_processors_that_took_them(tmp_path: Path) -> None:
    for name, processor in (("old", {}), ("new", {"processor": "AMD EPYC"})):
        (tmp_path / name).mkdir()
        journal = Journal(tmp_path / name)
        journal.write(Entry.OPENED, 0.0, **processor)
        journal.close()
    _, beside = time_tables([tmp_path / "old", tmp_path / "new"])
    assert beside.columns[1:] == ("thesis, algorithm, Intel i7-6700HQ", "here, not recorded, AMD EPYC")


def test_a_folder_that_is_not_a_run_is_refused(tmp_path: Path) -> None:
    with raises(NO_RUN_TO_TIME, match="STU-011"):
        time_tables([tmp_path / "nowhere"])


def deactivated(frames: int, commands: int) -> dict[str, Any]:
    counts = {"frames": {"frames": frames}, "link": {"commands": commands}}
    return {"event": "configured", "device": "tracker", "before": "active", **counts}


CONNECTED = {"event": "connected", "device": "tracker", "before": "disconnected"}


def test_the_counters_of_a_device_are_added_up_over_the_run_and_its_connections() -> None:
    log = [CONNECTED, deactivated(12, 60), deactivated(60, 122), CONNECTED, deactivated(30, 130)]
    assert link_counters(log) == (("tracker", "3 times", "frames 102, commands 252"),)
    assert link_counters([CONNECTED]) == ()
