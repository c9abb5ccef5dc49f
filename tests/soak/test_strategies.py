"""Twenty whole cases with each strategy, calibrated and not: all complete, as near as promised."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from simulated_case import write_scene
from user_commands import Commands

from procedures.strategies.catalogue import STRATEGIES
from ronna_hw.arm.catalogue import ArmChoice
from sim.world.scene.named_scenes import draw_scene

pytestmark = [pytest.mark.soak, pytest.mark.timeout(3600)]

SEEDS = range(20)
CASE_LIMIT_S = 300.0  # host time
TARGETS = 3  # of the default scene
CALIBRATED_MEAN_MM = 0.15
OTHER_ARM_MEAN_MM = 0.25  # with `ocs`, uncalibrated; 0.10 over six seeds of a UR5e
X_FRAME_MEAN_MM = {True: 0.20, False: 0.35}  # with `ocs`, calibrated or not; 0.11 and 0.28 were measured
# The neutral orientation leaves an arm's remaining errors in, the thesis' own OCS its backlash.
MEAN_MM = {"nos": 0.25, "thesis-ocs": 0.25}
MARGIN_MM = 5.0  # in the plan: of an uncalibrated arm in the neutral orientation more than 2 mm is predicted


def scene_file(folder: Path, seed: int) -> str:
    """The default scene with a margin that the neutral orientation meets too."""
    scene = draw_scene("default", seed=seed)
    targets = tuple(one.model_copy(update={"margin_mm": MARGIN_MM}) for one in scene.head.targets)
    changed = scene.model_copy(update={"head": scene.head.model_copy(update={"targets": targets})})
    return write_scene(changed, folder / f"scene-{seed}.toml")


def errors_of_every_seed(commands: Commands, folder: Path, calibrated: bool, *case: str) -> list[float]:
    """At the targets, in mm; every case must be done."""
    errors_mm = []
    for seed in SEEDS:
        own = "nos" in case and not calibrated
        scene = ["--scene", scene_file(folder, seed)] if own else ["--seed", str(seed)]
        words = ["--sim", *scene, *case, "--out", str(folder / "runs"), "--json"]
        words += ["--calibrated"] * calibrated
        done = commands.run("ronna-procedure", "run", *words, timeout_s=CASE_LIMIT_S)
        assert done.returncode == 0, f"seed {seed}: {done.stderr}"
        outcome = json.loads(done.stdout)
        assert outcome["outcome"] == "done"
        errors_mm += [row["application_error_mm"] for row in outcome["targets"]]
        shutil.rmtree(folder / "runs" / outcome["run"])
    assert len(errors_mm) == TARGETS * len(SEEDS)
    return errors_mm


@pytest.mark.parametrize("calibrated", [True, False], ids=["calibrated", "uncalibrated"])
@pytest.mark.parametrize("strategy", [one.name for one in STRATEGIES])
def test_every_seed_completes_with_each_strategy(
    commands: Commands, tmp_path: Path, strategy: str, calibrated: bool
) -> None:
    errors_mm = errors_of_every_seed(commands, tmp_path, calibrated, "--strategy", strategy)
    if calibrated:
        assert np.mean(errors_mm) <= MEAN_MM.get(strategy, CALIBRATED_MEAN_MM)


@pytest.mark.parametrize("calibrated", [True, False], ids=["calibrated", "uncalibrated"])
def test_every_seed_completes_with_the_x_shaped_frame(
    commands: Commands, tmp_path: Path, calibrated: bool
) -> None:
    errors_mm = errors_of_every_seed(commands, tmp_path, calibrated, "--fiducials", "xframe")
    assert np.mean(errors_mm) <= X_FRAME_MEAN_MM[calibrated]


@pytest.mark.parametrize("arm", [one.value for one in ArmChoice if one is not ArmChoice.KR6])
def test_every_seed_completes_with_another_arm(commands: Commands, tmp_path: Path, arm: str) -> None:
    errors_mm = errors_of_every_seed(commands, tmp_path, False, "--arm", arm)
    assert np.mean(errors_mm) <= OTHER_ARM_MEAN_MM
