"""The case on a terminal, as a person sees it: live progress, pause, stop."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from pseudo_terminal import CTRL_C, Terminal
from user_commands import Commands

IMPORTED = r"✓ Import the CT series \(ct_import\)"
CASE = ("run", "--sim", "--scene", "mini", "--seed", "3")


@pytest.fixture
def terminal(commands: Commands, tmp_path: Path) -> Iterator[Terminal]:
    opened = Terminal(commands, *CASE, "--out", str(tmp_path / "runs"))
    yield opened
    opened.close()


@pytest.mark.slow
def test_one_ctrl_c_pauses_and_only_the_listed_words_continue(terminal: Terminal) -> None:
    terminal.await_text(IMPORTED)
    terminal.type(CTRL_C)
    terminal.await_text("Paused: Ctrl-C")
    terminal.type("\n")
    terminal.await_text("(paused> .*){2}")
    terminal.type("stop\n")
    terminal.await_text("(paused> .*){3}")
    terminal.type("continue\n")
    assert terminal.rest() == 0
    assert "error mm" in terminal.text
    assert len(re.findall(r"report /\S+", terminal.text)) == 1


@pytest.mark.slow
def test_a_failed_step_leaves_the_case_at_a_prompt_from_which_it_can_go_home(
    commands: Commands, tmp_path: Path
) -> None:
    answers = tmp_path / "answers.toml"
    answers.write_text('[answers]\n"approach:T1" = "no"\n')
    terminal = Terminal(commands, *CASE, "--out", str(tmp_path / "runs"), "--answers", str(answers))
    try:
        terminal.await_text("held> ")
        assert "PRO-002" in terminal.text
        terminal.type("home\n")
        terminal.await_text("the arm is parked")
        terminal.type("quit\n")
        assert terminal.rest() == 7
        assert terminal.text.count("PRO-002 ") == 1  # with its advice, when it held the case; not at the end
    finally:
        terminal.close()


@pytest.mark.slow
@pytest.mark.parametrize("environment", [{"TERM": "dumb"}, {"TERM": "xterm", "NO_COLOR": "1"}], ids=str)
def test_no_command_that_shows_live_progress_sends_escape_codes_to_a_terminal_that_wants_none(
    commands: Commands, tmp_path: Path, environment: dict[str, str]
) -> None:
    runs, patient = tmp_path / "runs", tmp_path / "patient"

    def sent(command: str, *line: str) -> str:
        terminal = Terminal(commands, *line, command=command, environment=environment)
        try:
            assert terminal.rest() == 0, terminal.text[-2000:]
            return terminal.raw
        finally:
            terminal.close()

    case = sent("ronna-procedure", *CASE, "--out", str(runs))
    assert "done ct_import (Import the CT series)" in case  # lines in place of the live display
    run = next(runs.iterdir())
    shown = [case, *(sent("ronna-procedure", name, str(run)) for name in ("watch", "replay"))]
    shown.append(sent("ronna-procedure", "list", str(runs)))
    shown.append(sent("ronna-sim", "phantom", "--scene", "mini", "--out", str(patient)))
    shown.append(sent("ronna-ct", "localize", str(patient / "ct")))
    shown.append(sent("ronna-plan", "check", str(patient / "plan.toml"), "--ct", str(patient / "ct")))
    shown.append(sent("ronna-conformance", "tracker", "--sim"))
    assert [text for text in shown if "\x1b" in text] == []
