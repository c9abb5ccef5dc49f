"""Worlds drawn at random, carried out through the wires and judged by one command."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.slow
def test_a_few_worlds_are_judged_by_truth_and_kept(tmp_path: Path) -> None:
    out = tmp_path / "worlds"
    arguments = ["worlds", "--cases", "3", "--seed", "0", "--workers", "1", "--out", str(out), "--json"]
    ended = subprocess.run(
        [sys.executable, "-m", "studies.cli", *arguments],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert ended.returncode in (0, 1), ended.stderr
    verdicts, worst = json.loads(ended.stdout)["tables"]
    assert sum(row[1] for row in verdicts["rows"]) == 3
    assert {row[0] for row in worst["rows"]} == {0, 1, 2}
    for row in worst["rows"]:
        case = json.loads((out / "cases" / f"{row[0]:04d}" / "case.json").read_text())
        assert case["verdict"] == row[1] != "NO VERDICT"
        assert all(one["error_mm"] > 0.0 and one["limit_mm"] > 0.0 for one in case["targets"])


@pytest.mark.slow
@pytest.mark.parametrize("mode", [(), ("--quiet",)], ids=["changed", "quiet"])
def test_adversarial_worlds_are_judged_and_a_finished_campaign_is_not_run_again(
    tmp_path: Path, mode: tuple[str, ...]
) -> None:
    arguments = ["worlds", "--adversarial", "--cases", "2", "--seed", "0", *mode]
    arguments += ["--workers", "1", "--out", str(tmp_path), "--json"]
    printed = []
    for _ in range(2):
        ended = subprocess.run(
            [sys.executable, "-m", "studies.cli", *arguments],
            capture_output=True,
            text=True,
            timeout=900,
            check=False,
        )
        assert ended.returncode in (0, 1), ended.stderr
        printed.append(json.loads(ended.stdout)["tables"])
    assert printed[0] == printed[1]
    assert "2 of 2 units are done" in ended.stderr
    verdicts, bodies, cases = printed[0]
    assert sum(row[1] for row in verdicts["rows"][:-1]) == 2
    assert sum(row[1] for row in bodies["rows"]) == 2
    for row in cases["rows"]:
        case = json.loads((tmp_path / "cases" / f"{row[0]:04d}" / "case.json").read_text())
        assert (case["verdict"], case["ending"]) == (row[1], row[2])
        assert (case["script"] == "") is bool(mode)
        assert row[-1].startswith("ronna-procedure run --sim")
