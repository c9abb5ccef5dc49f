"""Comparison of a finished run with the truth: spheres missed by the CT localizer, and tip errors.

It uses the run's records and the truth sampled by the theatre; neither knows the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ronna_hw.bounded_input import read_json_bytes
from ronna_hw.calibration import PoseRecord
from ronna_hw.evidence.inspection import Inspection, inspect_run
from ronna_hw.evidence.journal_reading import JOURNAL_FILE, theatre_time_s
from ronna_hw.records import Record
from ronna_hw.text import format_count, format_names
from sim.errors import NOTHING_TO_VERIFY
from sim.phantom.scanner.grid import shown_mm
from sim.world.rigid import Matrix, Vector, apply, matrix_of
from sim.world.scene.model import Scene, parse_scene_json, read_scene
from sim.world.truth import (
    SCENE_FILE,
    THEATRE_FOLDER,
    TRUTH_FILE,
    TipSample,
    parse_samples,
    read_samples,
    truth_bytes,
)

WHERE_IT_WAS_MADE = "Give the folder of the theatre in which the run was made."
PARTS = ("registration_mm", "intrinsic_mm")  # of an error: eq. 40 to 42 of the thesis
SAME_SPHERE_MM = 2.0  # a found centre within this distance is that sphere; spheres are 11.5 mm wide


def verify_run(run: Path, theatre: Path | None = None) -> dict[str, Any]:
    """Compare a run folder with the ground truth of its simulated theatre.

    Raises SIM-006 when there is nothing to compare, SIM-007 when the truth cannot be read, PRO-033 for an
    altered run. A run made with `--sim` contains its theatre; for a run by hand, `theatre` is the folder of
    its theatre, which may have seen other runs and, by mistake, another patient.

    Returns `ct` (found, missed, false, rms_error_mm) and `targets` (id, depth_mm, application_error_mm,
    lateral_mm, axial_mm, axis_error_rad, parts, and how far from the axis of the guide an assistant held
    the instrument: held_off_mm, held_off_rad), as plain data; `other_samples` names those at no target of
    the plan. `parts` splits the error, as vectors in the robot frame: registration_mm from the true to the
    registered target, intrinsic_mm from there to the tip.
    """
    _require_single_run(run)
    place = run / THEATRE_FOLDER if theatre is None else theatre
    if not (place / SCENE_FILE).exists():
        if theatre is None:
            raise NOTHING_TO_VERIFY(f"{run} has no simulated theatre")
        raise NOTHING_TO_VERIFY(
            f"{theatre} is not the folder of a simulated theatre",
            expected=f"a folder with {SCENE_FILE}",
            action=WHERE_IT_WAS_MADE,
        )
    found = inspect_run(run).require_unchanged()
    if theatre is None:
        scene, tip_samples = _read_contained_truth(found, place)
    else:
        scene, tip_samples = (
            read_scene(place / SCENE_FILE),
            _select_samples_during(found, read_samples(place)),
        )
    samples = {sample.target: sample for sample in tip_samples}  # the last sample of each target
    localization = _find_valid_record(found, "fiducial_localization")
    if localization is None and not samples:
        raise NOTHING_TO_VERIFY(f"{run} located no sphere and reached no target")
    try:
        ct = _verify_ct(scene, localization)
        targets = [
            _verify_target(
                scene,
                trajectory,
                samples.pop(trajectory["id"]),
                _read_used_registration(found, trajectory["id"]),
            )
            for trajectory in _read_planned_trajectories(found)
            if trajectory["id"] in samples
        ]
    except (LookupError, TypeError, ValueError, ArithmeticError) as error:
        raise NOTHING_TO_VERIFY(f"a record of {run} is not what a run writes: {error!r}") from error
    if theatre is not None and ct is not None and not ct["found"]:
        raise NOTHING_TO_VERIFY(
            f"{theatre} has another patient than {run}: none of the spheres found is there",
            action=WHERE_IT_WAS_MADE,
        )
    return {"ct": ct, "targets": targets, "other_samples": list(samples)}


def _require_single_run(folder: Path) -> None:
    """Raise SIM-006 for a folder of several runs, listing them."""
    if not folder.is_dir() or (folder / JOURNAL_FILE).exists():
        return
    runs = sorted(one.name for one in folder.iterdir() if (one / JOURNAL_FILE).exists())
    if runs:
        raise NOTHING_TO_VERIFY(
            f"{folder} is not a run; it holds {format_count(len(runs), 'run')}: {format_names(runs)}",
            action=f"Give one of them: {folder / runs[-1]}.",
        )


def require_targets(run: Path, outcome: dict[str, Any]) -> None:
    """Raise SIM-006 unless the tip was sampled at a planned target, because an empty table is no success."""
    if outcome["targets"]:
        return
    other = ", ".join(outcome["other_samples"])
    raise NOTHING_TO_VERIFY(
        f"{run} reached no target: no instrument was inserted at a trajectory of its plan"
        + (f", but at {other}" if other else ""),
        action="Insert the instrument at each target: in a rehearsal by hand, ronna-sim work insert "
        "--trajectory T1 or the name in the question.",
    )


def _read_contained_truth(found: Inspection, place: Path) -> tuple[Scene, Sequence[TipSample]]:
    """Read the truth in a run folder, verifying the same bytes against its journal."""

    def read_checked(name: str, content: bytes) -> bytes:
        return found.require_content(f"{THEATRE_FOLDER}/{name}", content)

    truth = place / TRUTH_FILE
    scene = read_checked(SCENE_FILE, read_json_bytes(place / SCENE_FILE))
    samples = read_checked(TRUTH_FILE, truth_bytes(truth)) if truth.exists() else b""
    return parse_scene_json(scene, SCENE_FILE), parse_samples(samples)


def _select_samples_during(found: Inspection, samples: Sequence[TipSample]) -> Sequence[TipSample]:
    """Return the samples taken during the run, by the clock shared by theatre and run."""
    if not found.chain.lines:
        return ()
    began_s, ended_s = (theatre_time_s(line) for line in (found.chain.lines[0], found.chain.lines[-1]))
    return [one for one in samples if began_s <= one.theatre_time_s <= ended_s]


def _read_planned_trajectories(found: Inspection) -> list[dict[str, Any]]:
    """Return the trajectories of the run's plan, which may be named differently in the scene."""
    plan = _find_valid_record(found, "plan_check")
    return list(plan.payload["plan"]["trajectories"]) if plan is not None else []


def _find_valid_record(found: Inspection, kind: str) -> Record | None:
    valid = (one for one in reversed(found.records) if one.identifier not in found.superseded)
    return next((one for one in valid if one.kind == kind), None)


def _read_used_registration(found: Inspection, trajectory: str) -> Matrix | None:
    """Return robot <- ct (4, 4) by which the guide was led to a target, or None without a valid record."""
    valid = {one.identifier: one for one in found.records if one.identifier not in found.superseded}
    led = [one for one in valid.values() if one.kind == "positioning" and one.trajectory == trajectory]
    used = [valid[parent] for one in led[-1:] for parent in one.parents if parent in valid]
    registrations = [one for one in used if one.kind == "registration"]
    if not registrations:
        return None
    pose = registrations[-1].payload["robot_from_ct"]
    return matrix_of(PoseRecord(**{name: tuple(pose[name]) for name in PoseRecord.model_fields}))


def _verify_ct(scene: Scene, localization: Record | None) -> dict[str, Any] | None:
    if localization is None:
        return None
    true = np.array([fiducial.centre_ct_mm for fiducial in scene.head.fiducials])
    found = np.array([marker["centre_mm"] for marker in localization.payload["markers"]]).reshape(-1, 3)
    distances = (
        np.linalg.norm(found[:, None] - true[None], axis=2) if len(found) else np.zeros((0, len(true)))
    )
    hits = distances < SAME_SPHERE_MM
    errors = [float(distances[:, k].min()) for k in range(len(true)) if hits[:, k].any()]
    return {
        "found": len(errors),
        "missed": len(true) - len(errors),
        "false": int((~hits.any(axis=1)).sum()) if len(found) else 0,
        "rms_error_mm": float(np.sqrt(np.mean(np.square(errors)))) if errors else None,
    }


def _verify_target(
    scene: Scene, trajectory: dict[str, Any], sample: TipSample, registration: Matrix | None
) -> dict[str, Any]:
    robot_from_ct = sample.head_moved @ matrix_of(scene.head.robot_from_ct)
    target, entry = (
        apply(robot_from_ct, shown_mm(scene, trajectory[end])) for end in ("target_mm", "entry_mm")
    )
    tip = np.array(sample.tip_mm)
    planned_axis = (target - entry) / np.linalg.norm(target - entry)
    error = tip - target
    axial = float(error @ planned_axis)
    return {
        "id": sample.target,
        "depth_mm": float(np.linalg.norm(target - entry)),
        "application_error_mm": float(np.linalg.norm(error)),
        "lateral_mm": float(np.linalg.norm(error - axial * planned_axis)),
        "axial_mm": axial,
        "axis_error_rad": float(np.arccos(np.clip(np.array(sample.axis) @ planned_axis, -1.0, 1.0))),
        "guide_mounted": sample.mounted_tool == scene.mount.tool_number_guide,
        "arm_at_rest": sample.arm_at_rest,
        **({} if registration is None else {"parts": _split(registration, trajectory, target, tip)}),
        **({} if sample.held_off_mm is None else {"held_off_mm": sample.held_off_mm}),
        **({} if sample.held_off_rad is None else {"held_off_rad": sample.held_off_rad}),
    }


def _split(registration: Matrix, trajectory: dict[str, Any], true: Vector, tip: Vector) -> dict[str, Any]:
    """Return the error's two parts, whose sum it is: of the registration, and of the arm that trusts it."""
    registered = apply(registration, trajectory["target_mm"])
    return dict(zip(PARTS, ((registered - true).tolist(), (tip - registered).tolist()), strict=True))
