"""A whole case with two arms that are measured against each other and move in turn."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from ronna_hw.host.child_process import command

pytestmark = pytest.mark.slow

LIMIT_S = 900.0


def test_a_case_with_two_arms_knows_their_bases_to_a_tenth_of_a_millimetre(tmp_path: Path) -> None:
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
