"""A case operated over the console's routes, without a browser."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from console_script import ConsoleScript
from operated_case import OperatedCase, operated_cases
from waiting import eventually

from procedures.journal.journal import JOURNAL_FILE, read_journal

HANG_LIMIT_S = 120.0
BEGUN, DONE = "intent relocalization:T1", "result relocalization:T1"
PICTURE_PERIOD_S = 0.15  # ten orders a second are too many


def await_state(script: ConsoleScript, holds: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """The first state that meets the condition; whatever is asked before is answered."""
    deadline_s = time.monotonic() + HANG_LIMIT_S
    while not holds(state := script.state()):
        assert time.monotonic() < deadline_s, state
        if state["question"]:
            script.answer(state["question"])
        time.sleep(PICTURE_PERIOD_S)
    return state


def await_question(script: ConsoleScript, topic: str) -> dict[str, Any]:
    """The question of that topic, when it stands."""
    return dict(
        await_state(script, lambda state: (state["question"] or {}).get("topic") == topic)["question"]
    )


@pytest.mark.slow
def test_a_script_steps_through_a_whole_case_and_every_answer_is_signed(tmp_path: Path) -> None:
    with operated_cases(tmp_path) as start:
        case = start("step")
        script = ConsoleScript(case.addresses["url"])
        assert script.order("claim", name="Script") == ""
        deadline_s = time.monotonic() + HANG_LIMIT_S
        while (state := script.state())["state"] != "finished":
            assert time.monotonic() < deadline_s
            if state["question"]:
                assert script.answer(state["question"]) == ""
            elif state["waiting"] and state["upcoming"]:
                assert script.order("next", upcoming=state["upcoming"]) == ""
            time.sleep(PICTURE_PERIOD_S)
        case.process.wait(30)
        assert case.process.returncode == 0
        journal = read_journal(case.run / JOURNAL_FILE)
    confirmations = [line for line in journal if line["entry"] == "confirmation"]
    assert {line["by"] for line in confirmations} == {"Script"}
    assert all(len(str(line["shown"])) == 64 for line in confirmations)
    keys = case.addresses["url"].partition("=")[2], case.addresses["viewer_url"].partition("=")[2]
    for file in (path for path in case.run.rglob("*") if path.is_file()):
        content = file.read_bytes()
        assert not any(key.encode() in content for key in keys), f"{file} has a key of the console"


@pytest.mark.slow
def test_the_case_completes_without_a_console_that_stopped_responding(tmp_path: Path) -> None:
    with operated_cases(tmp_path) as start:
        case = start("run")
        os.kill(case.console_pid, signal.SIGSTOP)
        assert case.process.wait(90) == 0
        assert "mean" in case.output.read_text()


@pytest.mark.slow
def test_the_terminal_operates_a_case_whose_console_was_killed_while_the_arm_moved(tmp_path: Path) -> None:
    with operated_cases(tmp_path) as start:
        case, types = start.at_terminal("step", "--speed", "1")

        def of_the_step() -> list[str]:
            lines = [line for line in read_journal(case.run / JOURNAL_FILE)]
            names = [f"{line['entry']} {line.get('step', '')}" for line in lines]
            return names[names.index(BEGUN) :] if BEGUN in names else []

        script = ConsoleScript(case.addresses["url"])
        assert script.order("claim", name="Script") == ""
        await_state(script, lambda state: state["waiting"])
        assert script.order("run_to", upcoming="ct_import", step="relocalization:T1") == ""
        await_state(script, lambda _state: any(line.startswith("motion") for line in of_the_step()))
        os.kill(case.console_pid, signal.SIGKILL)
        assert DONE not in of_the_step()
        eventually(lambda: "this terminal operates the case" in case.said, HANG_LIMIT_S)
        eventually(lambda: DONE in of_the_step(), HANG_LIMIT_S)
        types("run relocalization:T1")
        eventually(lambda: "Type yes or no" in case.said, HANG_LIMIT_S)
        types("no")
        eventually(lambda: "PRO-002" in case.said, HANG_LIMIT_S)
        types("quit")
        case.ended()


@pytest.mark.slow
def test_a_fault_is_acknowledged_by_name_once_its_cause_is_gone_and_the_case_continues(
    tmp_path: Path,
) -> None:
    with operated_cases(tmp_path) as start:
        case = start("step")
        script = ConsoleScript(case.addresses["url"])
        assert script.order("claim", name="A. Nurse") == ""
        await_state(script, lambda state: state["waiting"])
        assert script.order("run_to", upcoming="ct_import", step="path_check") == ""
        assert script.answer(await_question(script, "patient")) == ""
        await_state(script, lambda state: state["waiting"] and state["upcoming"] == "relocalization:T1")
        simulator(case, "robot emergency stop")
        assert script.order("next", upcoming="relocalization:T1") == ""
        await_state(script, lambda state: state["state"] == "held")
        assert script.order("acknowledge") == ""  # taken; what keeps it from being done is told as a fault
        simulator(case, "--clear")
        await_state(script, lambda state: state["waiting"])
        assert script.order("acknowledge") == ""
        eventually(lambda: "acknowledged by A. Nurse: arm" in case.said)
        await_state(script, lambda state: state["waiting"])
        assert script.order("next", upcoming="relocalization:T1") == ""
        assert script.answer(await_question(script, "first_motion")) == ""
        await_state(script, lambda state: state["steps"]["relocalization:T1"] == "done")


@pytest.mark.slow
def test_a_killed_case_is_resumed_once_an_operator_takes_the_seat(tmp_path: Path) -> None:
    with operated_cases(tmp_path) as start:
        left = start("step")
        script = ConsoleScript(left.addresses["url"])
        assert script.order("claim", name="Script") == ""
        await_state(script, lambda state: state["waiting"])
        assert script.order("run_to", upcoming="ct_import", step="path_check") == ""
        assert script.answer(await_question(script, "patient")) == ""
        await_state(script, lambda state: state["steps"].get("path_check") == "done")
        left.process.kill()
        left.process.wait()

        case = start.resume(left)
        script = ConsoleScript(case.addresses["url"])
        state = await_state(script, lambda state: bool(state["steps"]))
        assert state["steps"]["path_check"] == "done"
        assert state["question"] is None, "nothing is asked before somebody sits in the seat"
        assert script.order("claim", name="Script") == ""
        assert script.answer(await_question(script, "resume")) == ""
        state = await_state(script, lambda state: state["waiting"])
        assert state["upcoming"] == "relocalization:T1"
        assert script.order("next", upcoming="relocalization:T1") == ""
        assert script.answer(await_question(script, "first_motion")) == ""
        await_state(script, lambda state: state["steps"]["relocalization:T1"] == "done")


def simulator(case: OperatedCase, fault: str) -> None:
    """Put a fault into the case's theatre, or clear it."""
    control = re.findall(r"control port (\S+)", case.said)[0]
    line = [sys.executable, "-P", "-m", "sim.cli", "fault", fault, "--control", control]
    assert subprocess.run(line, check=False, capture_output=True).returncode == 0
