"""What a case comes to when nothing happens to it: run here, as its last digits depend on the processor."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from shared_by_workers import made_once
from user_commands import Commands

MINI_SEED_3, MINI_SEED_7 = (
    ("run", "--sim", "--scene", "mini", "--seed", str(seed), "--json") for seed in (3, 7)
)


def undisturbed_mini(factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What seed 3 of the mini scene printed, run once for all tests."""
    outcome: dict[str, Any] = json.loads(_run(factory, "undisturbed-3", MINI_SEED_3)[1])
    return outcome


def finished_mini(factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Folder of runs with seed 7 of the mini scene alone, to be read only, and what it printed."""
    return _run(factory, "undisturbed-7", MINI_SEED_7)


def _run(factory: pytest.TempPathFactory, name: str, case: tuple[str, ...]) -> tuple[Path, str]:
    def run(out: Path) -> str:
        commands = Commands()
        done = commands.run("ronna-procedure", *case, "--out", str(out))
        assert done.returncode == 0, done.stderr
        assert commands.await_no_survivors() == []
        return done.stdout

    return made_once(factory, name, run)
