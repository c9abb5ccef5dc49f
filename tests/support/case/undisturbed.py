"""What a case comes to when nothing happens to it: run here, as its last digits depend on the processor."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from shared_by_workers import made_once
from user_commands import Commands

MINI_SEED_3 = ("run", "--sim", "--scene", "mini", "--seed", "3", "--json")


def undisturbed_mini(factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What seed 3 of the mini scene printed, run once for all tests."""
    outcome: dict[str, Any] = json.loads(_run_mini(factory)[1])
    return outcome


def undisturbed_mini_runs(factory: pytest.TempPathFactory) -> Path:
    """Folder of runs with that one case."""
    return _run_mini(factory)[0]


def _run_mini(factory: pytest.TempPathFactory) -> tuple[Path, str]:
    def run(out: Path) -> str:
        commands = Commands()
        done = commands.run("ronna-procedure", *MINI_SEED_3, "--out", str(out))
        assert done.returncode == 0, done.stderr
        assert commands.await_no_survivors() == []
        return done.stdout

    return made_once(factory, "undisturbed_mini", run)
