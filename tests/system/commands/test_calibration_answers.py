"""An answers file serves every calibration as it serves a case."""

from __future__ import annotations

from pathlib import Path

import pytest
import typer
from user_commands import in_this_process, one_error

from procedures.cli.arm.command import app as ronna_arm
from procedures.cli.procedure import app as ronna_procedure
from procedures.cli.stereo.command import app as ronna_stereo
from procedures.journal.journal import JOURNAL_FILE, Entry, read_journal
from ronna_hw.errors import EXIT_ABORTED


@pytest.mark.slow
@pytest.mark.parametrize(
    ("app", "command"),
    [
        (ronna_arm, ("calibrate",)),
        (ronna_stereo, ("calibrate",)),
        (ronna_procedure, ("calibrate", "tracker-frame")),
        (ronna_procedure, ("calibrate", "tool-tip")),
    ],
    ids=["arm", "stereo", "tracker-frame", "tool-tip"],
)
def test_a_calibration_declined_by_the_answers_moves_nothing_and_writes_no_record(
    app: typer.Typer, command: tuple[str, ...], tmp_path: Path
) -> None:
    answers = tmp_path / "answers.toml"
    answers.write_text('[answers]\ncalibration = "no"\n')
    out = tmp_path / "out"
    sim = ("--sim", "--scene", "mini", "--seed", "3", "--out", out, "--answers", answers)
    done = in_this_process(app, *command, *sim)
    assert "PRO-002" in " ".join(one_error(done.stderr))
    assert done.returncode == EXIT_ABORTED
    assert not list(out.rglob("calibration.toml"))
    (journal,) = out.rglob(JOURNAL_FILE)
    assert [line for line in read_journal(journal) if line["entry"] == Entry.MOTION] == []
