"""Whole cases on a CT that was mirrored or turned on its way: refused before anything is positioned."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import mirrored_case
import pytest

from ronna_hw.errors import EXIT_REFUSED

pytestmark = [pytest.mark.slow, pytest.mark.hazard(7), pytest.mark.timeout(2400)]

KINDS = (*mirrored_case.KINDS, *mirrored_case.MIRRORS)
SCENES = (("mini",), ("default",), ("mini", "--fiducials", "xframe"), ("mini", "--markers", "4"))
LARGEST_ERROR_MM = 1.5


def run(out: Path, seed: int, *words: str, spoilt: str = "") -> subprocess.CompletedProcess[str]:
    program = [sys.executable, mirrored_case.__file__, spoilt] if spoilt else [sys.executable, "-P", "-m"]
    module = [] if spoilt else ["procedures.cli.procedure"]
    options = ["run", "--sim", "--scene", *words, "--seed", str(seed), "--out", str(out), "--json"]
    return subprocess.run([*program, *module, *options], capture_output=True, text=True, timeout=300)


def refused_in_time(out: Path, done: subprocess.CompletedProcess[str]) -> bool:
    """Whether it was refused, and no guide had been moved to a trajectory."""
    journals = [path.read_text(encoding="utf-8").splitlines() for path in out.rglob("journal.jsonl")]
    lines = [json.loads(line) for journal in journals for line in journal]
    steps = {str(line.get("step")).partition(":")[0] for line in lines}
    return done.returncode == EXIT_REFUSED and "positioning" not in steps


def test_no_guide_is_positioned_by_twenty_spoilt_cts(tmp_path: Path) -> None:
    for number in range(20):
        kind, scene = KINDS[number % len(KINDS)], SCENES[number % len(SCENES)]
        done = run(tmp_path / str(number), number, *scene, spoilt=kind)
        assert refused_in_time(tmp_path / str(number), done), f"{kind} {scene} {number}: {done.stderr}"


def test_twenty_honest_cts_reach_their_targets(tmp_path: Path) -> None:
    for number in range(20):
        done = run(tmp_path, number, *SCENES[number % len(SCENES)])
        assert done.returncode == 0, f"{SCENES[number % len(SCENES)]} {number}: {done.stderr}"
        assert json.loads(done.stdout)["max_application_error_mm"] <= LARGEST_ERROR_MM
