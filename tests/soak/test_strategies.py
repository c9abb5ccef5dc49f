"""Twenty whole cases with each strategy, calibrated and not: all complete, as near as promised."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from user_commands import Commands

from procedures.strategies.catalogue import STRATEGIES

pytestmark = [pytest.mark.soak, pytest.mark.timeout(3600)]

SEEDS = range(20)
CASE_LIMIT_S = 300.0  # host time
TARGETS = 3  # of the default scene
CALIBRATED_MEAN_MM = 0.15
NEUTRAL_CALIBRATED_MEAN_MM = 0.25  # the neutral orientation leaves an arm's remaining errors in


@pytest.mark.parametrize("calibrated", [True, False], ids=["calibrated", "uncalibrated"])
@pytest.mark.parametrize("strategy", [one.name for one in STRATEGIES])
def test_every_seed_completes_with_each_strategy(
    commands: Commands, tmp_path: Path, strategy: str, calibrated: bool
) -> None:
    errors_mm = []
    for seed in SEEDS:
        words = ["--sim", "--seed", str(seed), "--strategy", strategy, "--out", str(tmp_path), "--json"]
        words += ["--calibrated"] * calibrated
        done = commands.run("ronna-procedure", "run", *words, timeout_s=CASE_LIMIT_S)
        assert done.returncode == 0, f"seed {seed}: {done.stderr}"
        outcome = json.loads(done.stdout)
        assert outcome["outcome"] == "done"
        errors_mm += [row["application_error_mm"] for row in outcome["targets"]]
        shutil.rmtree(tmp_path / outcome["run"])
    assert len(errors_mm) == TARGETS * len(SEEDS)
    if calibrated:
        assert np.mean(errors_mm) <= (NEUTRAL_CALIBRATED_MEAN_MM if strategy == "nos" else CALIBRATED_MEAN_MM)
