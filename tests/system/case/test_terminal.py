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
