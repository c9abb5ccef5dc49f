"""`ronna-procedure verify RUN`: every file that is not as the run left it."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from procedures.exchange.raw_readings import WRITES_ALL, missing_in_raw
from ronna_hw.command_line.terminal import print_json, say
from ronna_hw.errors import EXIT_REFUSED, EXIT_UNCONFIRMED
from ronna_hw.evidence.inspection import inspected
from ronna_hw.evidence.manifest import files_of, unchecked_folders
from ronna_hw.evidence.unsealed import unsealed_sentences
from ronna_hw.text import counted, printable


def verify(folder: Path, *, as_json: bool) -> None:
    """Print what is changed, missing or added; ends with exit code 3 when anything is.

    It ends with 9 when nothing is, but files lay unsealed after a kill: a change then would not show.
    """
    found = inspected(folder)
    problems, missing = found.problems, missing_in_raw(folder, found.chain.lines)
    not_vouched_for = list(unsealed_sentences(found.chain.lines))
    unchecked = unchecked_folders(folder)
    checked = sum(1 for _ in files_of(folder))
    if as_json:
        print_json(
            {
                "run": folder.resolve().name,
                "whole": not problems,
                "files": checked,
                "problems": [asdict(one) for one in problems],
                "not_vouched_for": not_vouched_for,
                "not_checked": unchecked,
                "out_of_reach": found.out_of_reach,
                "raw_missing": missing,
            }
        )
    else:
        for problem in problems:
            say(str(problem))
        if not problems:
            intact, since = "intact", ""
            if not_vouched_for:
                intact, since = "intact as far as can be said", ", or as they lay when it was resumed"
            say(f"{folder.resolve().name}: {intact}, {checked} files are as the run left them{since}")
        for sentence in not_vouched_for:
            say(sentence)
        if absent := found.out_of_reach:
            inputs = counted(len(absent), "input")
            say(f"not compared: {inputs} outside the run, whose folder is not there: {printable(absent[0])}")
        if unchecked:
            say(f"not part of the run, and not checked: {', '.join(unchecked)}")
        if missing:
            say(f"{missing}; {WRITES_ALL}")
    if problems:
        raise SystemExit(EXIT_REFUSED)
    if not_vouched_for:
        raise SystemExit(EXIT_UNCONFIRMED)
