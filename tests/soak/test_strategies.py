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
X_FRAME_MEAN_MM = {True: 0.20, False: 0.35}  # with `ocs`, calibrated or not; 0.11 and 0.28 were measured
NEUTRAL_CALIBRATED_MEAN_MM = 0.25  # the neutral orientation leaves an arm's remaining errors in


def errors_of_every_seed(commands: Commands, folder: Path, calibrated: bool, *case: str) -> list[float]:
    """At the targets, in mm; every case must be done."""
    errors_mm = []
    for seed in SEEDS:
        words = ["--sim", "--seed", str(seed), *case, "--out", str(folder), "--json"]
        words += ["--calibrated"] * calibrated
        done = commands.run("ronna-procedure", "run", *words, timeout_s=CASE_LIMIT_S)
        assert done.returncode == 0, f"seed {seed}: {done.stderr}"
        outcome = json.loads(done.stdout)
        assert outcome["outcome"] == "done"
        errors_mm += [row["application_error_mm"] for row in outcome["targets"]]
        shutil.rmtree(folder / outcome["run"])
    assert len(errors_mm) == TARGETS * len(SEEDS)
    return errors_mm


@pytest.mark.parametrize("calibrated", [True, False], ids=["calibrated", "uncalibrated"])
@pytest.mark.parametrize("strategy", [one.name for one in STRATEGIES])
def test_every_seed_completes_with_each_strategy(
    commands: Commands, tmp_path: Path, strategy: str, calibrated: bool
) -> None:
    errors_mm = errors_of_every_seed(commands, tmp_path, calibrated, "--strategy", strategy)
    if calibrated:
        assert np.mean(errors_mm) <= (NEUTRAL_CALIBRATED_MEAN_MM if strategy == "nos" else CALIBRATED_MEAN_MM)


@pytest.mark.parametrize("calibrated", [True, False], ids=["calibrated", "uncalibrated"])
def test_every_seed_completes_with_the_x_shaped_frame(
    commands: Commands, tmp_path: Path, calibrated: bool
) -> None:
    errors_mm = errors_of_every_seed(commands, tmp_path, calibrated, "--fiducials", "xframe")
    assert np.mean(errors_mm) <= X_FRAME_MEAN_MM[calibrated]
