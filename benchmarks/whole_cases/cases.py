"""Whole cases, one after the other, each as a user types it; every attempt is kept."""

from __future__ import annotations

import json
import resource
import shutil
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from benchmarks.whole_cases.conditions import Condition
from ronna_hw import load_run
from ronna_hw.arm.catalogue import ArmChoice
from ronna_hw.host.child_process import ChildNotReady, command, run_command
from ronna_hw.software import identify_software
from sim.world.head_surface.bare_bone import BareBone
from sim.world.head_surface.skin_shift import SkinShift
from sim.world.rigid import as_point
from sim.world.scene.model import Scene
from sim.world.scene.named_scenes import draw_scene
from sim.world.scene.skin import skin_point

Attempt = dict[str, Any]

CASE_LIMIT_S = 7200.0  # of host time: these cases leave the processor to everything else
MOST_ATTEMPTS = 4
FINISHED = ("done", "in doubt", "missed")  # outcomes of a case whose steps were all done
CASES_FILE = "cases.jsonl"
FOREHEAD = np.array([0.0, -0.85, 0.5])  # from the middle of the head, above the brows
DIGITS = 4


def measure_cases(folder: Path, conditions: Sequence[Condition], seeds: Sequence[int]) -> Iterator[Attempt]:
    """Run every case that is not settled in the folder yet, and append and yield each attempt."""
    folder.mkdir(parents=True, exist_ok=True)
    kept, software = load_attempts(folder), identify_software()
    for condition in conditions:
        for seed in seeds:
            own = [one for one in kept if (one["case"], one["seed"]) == (condition.name, seed)]
            while not is_settled(own):
                attempt = {"case": condition.name, "seed": seed, "attempt": len(own) + 1}
                attempt |= _run_case(folder, condition, seed) | {"commit": software.commit}
                own.append(attempt)
                with (folder / CASES_FILE).open("a", encoding="utf-8") as file:
                    file.write(json.dumps(attempt) + "\n")
                yield attempt


def load_attempts(folder: Path) -> list[Attempt]:
    path = folder / CASES_FILE
    return [json.loads(line) for line in path.read_text("utf-8").splitlines()] if path.exists() else []


def is_settled(attempts: Sequence[Attempt]) -> bool:
    """Return whether a case needs no further attempt: it finished, or failed twice with the same error."""
    if any(one["outcome"] in FINISHED for one in attempts) or len(attempts) == MOST_ATTEMPTS:
        return True
    codes = [one["error"] and one["error"]["code"] for one in attempts]
    return len(set(codes)) < len(codes)


def _run_case(folder: Path, condition: Condition, seed: int) -> Attempt:
    """Run one case in a process of its own, and return what it reached, without its run folder."""
    runs = folder / "runs"
    shutil.rmtree(runs, ignore_errors=True)
    before_s = _children_s()
    words = [*_scene_options(folder, condition, seed), "--strategy", condition.strategy, *condition.options]
    try:
        ended = run_command(
            "ronna-procedure run",
            command("procedures.cli.procedure", "run", "--sim", *words, "--out", str(runs), "--json"),
            CASE_LIMIT_S,
        )
        said = json.loads(ended.stdout)
    except ChildNotReady as problem:
        said = {"outcome": "failed", "error": {"code": problem.code, "what": problem.what}}
    measured = _read_targets(runs) if said["outcome"] in FINISHED else {}
    shutil.rmtree(runs, ignore_errors=True)
    ct = said.get("ct")
    return {
        "outcome": said["outcome"],
        "error": said.get("error"),
        "left_out": said.get("left_out", {}),
        "ct_rms_mm": ct and ct["rms_error_mm"] and round(ct["rms_error_mm"], 2 * DIGITS - 2),
        "theatre_s": said.get("sim_s"),
        "late_cycles": said.get("late_cycles"),
        **measured,
        "processor_s": round(_children_s() - before_s, 1),
    }


def _scene_options(folder: Path, condition: Condition, seed: int) -> list[str]:
    """Return the options for the default scene, from a file if there is no option for what differs."""
    usual = replace(condition, group="", strategy="", options=(), arm=ArmChoice.KR6)
    if usual == Condition("", ""):
        return ["--arm", condition.arm.value, "--seed", str(seed)]
    targets = condition.targets
    drawn = draw_scene("default", seed=seed, arm=condition.arm, fiducials=condition.carrier, targets=targets)
    changed = _change(drawn, condition).model_dump(mode="json", by_alias=True, exclude_none=True)
    path = folder / "scene.toml"
    path.write_text(tomli_w.dumps(changed), encoding="utf-8")
    return ["--scene", str(path)]


def _change(scene: Scene, condition: Condition) -> Scene:
    """Return the scene with its spheres refitted otherwise, its skin unmoved, or its bone bare."""
    head = scene.head.model_copy(update={"seating_error_mm": condition.seating_mm})
    if condition.is_rigid:
        head = head.model_copy(update={"skin_shift": SkinShift()})
    if condition.bare_bone_mm:
        middle, _ = skin_point(head, FOREHEAD)
        opening = BareBone(centre_ct_mm=as_point(middle), radius_mm=condition.bare_bone_mm)
        head = head.model_copy(update={"bare_bone": opening})
    return scene.model_copy(update={"head": head})


def _read_targets(runs: Path) -> Attempt:
    """Return errors, predictions and looks from the only run in the folder."""
    (folder,) = runs.iterdir()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a benchmark is no place for notes on a single run
        run = load_run(folder)
        targets, looks, spheres = run.targets, run.looks, run.localized
    columns = {
        "errors_mm": targets.error_mm,
        "predicted_mm": targets.predicted_mm,
        "limits_mm": targets.limit_mm,
    }
    reached = np.isfinite(targets.error_mm)
    return {
        "targets": [str(one) for one in targets.name[reached]],
        **{name: [round(float(one), DIGITS) for one in column[reached]] for name, column in columns.items()},
        "looks": len(looks.look),
        "localizations": len(spheres.looks),
    }


def _children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
