"""A mini case over the real protocols, with (`kept`) or without (`bare`) journal, events and recorders.

    python -P bare_case.py kept|bare SPEED SEED FOLDER

Prints one JSON line: wall seconds, and CPU seconds of the program with everything that it started.
"""

from __future__ import annotations

import contextlib
import json
import resource
import sys
import time
from pathlib import Path
from typing import Any
from unittest.mock import patch

from procedures.engine import run_folder
from procedures.engine.events import event_file, stream
from procedures.journal import journal
from procedures.runs import lifecycle
from procedures.runs.folders import new_run_folder
from procedures.runs.observers import RunObservers
from procedures.runs.request import CaseProcedure, RunRequest, SceneChoice
from ronna_hw.recording import flight_recorder, reading_tape
from ronna_hw.theatre import Theatre


class _NullObject:
    """Object that accepts any call and does nothing."""

    def __init__(self, *_given: object) -> None: ...

    def __getattr__(self, _name: str) -> Any:
        return lambda *_words, **_more: None


def keep_nothing() -> None:
    """Disable all recording of run history for the rest of the process.

    A name that no longer exists is an error: otherwise the bare case would do more work than claimed.
    """
    for owner, name, instead in (
        (journal.Journal, "_append", _ignore),
        (stream.EventStream, "publish", _ignore),
        (event_file, "EventFile", _NullObject),
        (flight_recorder, "FlightRecorder", _NullObject),
        (reading_tape, "ReadingTape", _NullTape),
        (reading_tape, "tape_device", lambda device, _tape: device),
        (Theatre, "record_bytes", _ignore),
        (run_folder, "hash_files_at_closing", lambda _folder: {}),
    ):
        patch.object(owner, name, instead).start()


def _ignore(*_words: object, **_more: object) -> None: ...


class _NullTape(_NullObject):
    def beside(self) -> Any:
        return contextlib.nullcontext()


def main(kept: str, speed: str, seed: str, folder: str) -> None:
    if kept == "bare":
        keep_nothing()
    request = RunRequest(
        procedure=CaseProcedure(), choice=SceneChoice("mini", int(seed), None, None), speed=speed
    )
    began = time.perf_counter()
    run = new_run_folder(request, Path(folder))
    with lifecycle.open_run(request, run, RunObservers()) as engine:
        engine.run_to()
    wall_s = time.perf_counter() - began
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    cpu_s = sum(usage.ru_utime + usage.ru_stime for usage in usages)
    print(json.dumps({"wall_s": wall_s, "cpu_s": cpu_s}))


if __name__ == "__main__":
    main(*sys.argv[1:5])
