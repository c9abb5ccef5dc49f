"""The command line checks the step names in a fault script; the theatre has no list of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from procedures.runs.request_checks import check_fault_script, list_unreached_faults
from ronna_hw.command_line.errors import UsageMistake

STEPS = ("registration", "at_target")


def _script(folder: Path, text: str) -> Path:
    path = folder / "faults.txt"
    path.write_text(text)
    return path


def test_known_steps_are_accepted_with_and_without_a_target(tmp_path: Path) -> None:
    check_fault_script(
        _script(
            tmp_path,
            "at 1 s: robot drop 5 % for 1 s\n"
            "when step == registration: robot drop 5 % for 1 s  # when step == tea\n"
            "  when step==at_target:T1: camera drop 1 %\n",
        ),
        STEPS,
    )


def test_every_unknown_step_is_reported_with_its_line_and_the_known_steps(tmp_path: Path) -> None:
    text = "when step == tea: robot drop 5 %\n\nwhen step == at_targets:T1: robot drop 5 %\n"
    with pytest.raises(UsageMistake) as caught:
        check_fault_script(_script(tmp_path, text), STEPS)
    message = str(caught.value)
    assert "line 1: there is no step 'tea'; line 3: there is no step 'at_targets'" in message
    assert "expected one of registration, at_target" in message


def test_a_missing_script_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageMistake, match="there is no fault script"):
        check_fault_script(tmp_path / "none.txt", STEPS)


def test_a_fault_whose_step_or_time_the_case_did_not_reach_is_named_at_its_end(tmp_path: Path) -> None:
    text = (
        "at 12.5 s: robot drop 5 %\n"
        "at 999999 s: robot drop 5 %\n"
        "when step == at_target: robot drop 5 %\n"
        "when step == at_target:T1: robot drop 5 %\n"
        "since step == at_target:T9: room shift cart 0 2 0 mm\n"
        "at cycle 500: robot drop 5 %\n"
    )
    assert [*list_unreached_faults(_script(tmp_path, text), ("registration", "at_target:T1"), 60.04)] == [
        "line 2 of faults.txt had no effect: the case ended after 60.0 s",
        "line 5 of faults.txt had no effect: the case did not run at_target:T9",
    ]
