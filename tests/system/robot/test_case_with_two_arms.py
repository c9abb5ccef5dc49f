"""A whole case with two arms: bases, motions in turn, insertion by the assistant."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from procedures.journal.journal import Entry
from ronna_hw.config import ASSISTANT
from ronna_hw.host.child_process import command

pytestmark = pytest.mark.slow

LIMIT_S = 900.0


def test_the_assistant_inserts_the_instrument_both_arms_go_home_and_the_run_replays(tmp_path: Path) -> None:
    options = ("--sim", "--dual", "--scene", "mini", "--seed", "0", "--out", str(tmp_path), "--json")
    ended = subprocess.run(
        command("procedures.cli.procedure", "run", *options),
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    (run,) = tmp_path.iterdir()
    (bases,) = (run / "records").glob("*-base_to_base.json")
    assert json.loads(bases.read_text())["payload"]["error_mm"] <= 0.1
    journal = [json.loads(line) for line in (run / "journal.jsonl").read_text().splitlines()]
    moved = [line["what"] for line in journal if line["entry"] == Entry.MOTION and line["arm"] == ASSISTANT]
    assert moved[-3:] == ["insert", "withdraw", "home"]
    again = subprocess.run(
        command("procedures.cli.procedure", "replay", str(run)),
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert again.returncode == 0, again.stderr
