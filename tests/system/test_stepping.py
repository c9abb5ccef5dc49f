"""`ronna-procedure step --sim`: the case by hand."""

import subprocess
from pathlib import Path

import pytest
from user_commands import Commands


def _step(commands: Commands, out: Path, *lines: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        commands.line(
            "ronna-procedure", "step", "--sim", "--scene", "mini", "--seed", "3", "--out", str(out)
        ),
        env=commands.environment,
        input="\n".join(lines) + "\n",
        capture_output=True,
        text=True,
        timeout=150,
        check=False,
    )


def test_steps_are_listed_run_refused_with_reasons_and_left(commands: Commands, tmp_path: Path) -> None:
    done = _step(
        commands,
        tmp_path,
        "list",
        "next",
        "why positioning:T1",
        "run positioning:T1",
        "quit",
    )
    assert done.returncode == 0, done.stderr
    assert "next  ct_import" in done.stdout
    assert "done ct_import: " in done.stdout
    assert "positioning:T1: refused: it may not follow" in done.stdout
    assert "no result of registration" in done.stdout
    assert "PRO-001" in done.stderr


@pytest.mark.slow
def test_an_unknown_step_is_told_and_the_case_goes_on(commands: Commands, tmp_path: Path) -> None:
    done = _step(commands, tmp_path, "run drilling", "to plan_check", "quit")
    assert done.returncode == 0
    assert "PRO-005" in done.stderr
    assert "done plan_check: " in done.stdout
