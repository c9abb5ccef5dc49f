"""The spans of a run, from lines of a journal."""

from __future__ import annotations

from procedures.journal.journal import Entry, JournalValue, Line
from procedures.reporting.run_statistics import timeline


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
