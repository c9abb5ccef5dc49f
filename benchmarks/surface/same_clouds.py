"""Registration on the skin by ours, the thesis' closest points, small-gicp and Open3D, on the same clouds.

    python -m benchmarks.surface.same_clouds --python PEERS/bin/python [--heads 4] [--seed 77] [--out DIR]

PEERS is an environment with `numpy`, `small-gicp` and `open3d-cpu` (extra `clouds`). A peer is shown with the
setting that has the least mean error on these very clouds, chosen after the fact in its favour; ours has no
setting. Errors are compared on the clouds that ours accepted, and shown on those that it refused: no peer
refuses any.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import time
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from procedures.registration.surface.peers import register_by_closest_points
from procedures.registration.surface.surface_registration import register_surface
from ronna_hw.arrays import Array
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Transform
from studies.campaign.study import Cell, Table, Unit, generator
from studies.surface.conditions import Coverage
from studies.surface.export import export_study, scan_name
from studies.surface.heads import HeadInCt
from studies.surface.kinds import Kinds
from studies.surface.scanning import Trial
from studies.surface.study import TARGETS_SEED, SurfaceStudy, draw_unit

OURS = "ours"
BY_AXES = "closest points from the principal axes (thesis)"
BY_CLOSEST = "closest points from the start (thesis)"
OVERLAPS = (0.8, 0.95)
FAR_MM = 5.0  # a mean error beyond is a registration that failed
Results = dict[str, dict[str, dict[str, float]]]  # method -> setting -> scan -> mean error, mm


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--python", type=Path, required=True)
    parser.add_argument("--heads", type=int, default=4)
    parser.add_argument("--seed", type=int, default=77)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/surface/clouds"))
    given = parser.parse_args()
    study = SurfaceStudy(given.heads, given.seed, shifts=0, kinds=Kinds.JUDGED)
    export_study(study, given.out, lambda share: None)
    poses = given.out / "peers.jsonl"
    script = Path(__file__).parents[1] / "peers" / "cloud_peers.py"
    subprocess.run([given.python, script, given.out, poses], check=True)
    found, seconds, refused = _register(study)
    _add_peers(found, seconds, poses, study)
    names = [scan_name(unit) for unit in study.units()]
    table = _table(found, seconds, names, refused)
    document = {
        "heads": given.heads,
        "seed": given.seed,
        "scans": len(names),
        "refused": refused,
        "errors_mm": found,
        "table": table.document(),
    }
    (given.out / "same_clouds.json").write_text(json.dumps(document, indent=1), encoding="utf-8")
    (given.out / "same_clouds.md").write_text(table.markdown(), encoding="utf-8")
    print(table.markdown())


def _register(study: SurfaceStudy) -> tuple[Results, dict[str, float], dict[str, str]]:
    """Register all scans by ours and by the thesis' methods; also processor time, and refusals of ours."""
    found: Results = {}
    seconds: dict[str, float] = {}
    refused: dict[str, str] = {}
    for unit in study.units():
        in_ct, trial, draw = draw_unit(study.seed, unit)
        surface, name = in_ct.shown_by(draw.offset_mm, trial.slices), scan_name(unit)
        targets = _targets(study, unit, in_ct)
        ways = {(OURS, ""): partial(_ours, trial, surface, targets)}
        if unit.condition.startswith(f"{Coverage.ALL}|"):  # principal axes need the whole head
            ways[BY_AXES, ""] = partial(register_by_closest_points, trial.scan, surface)
        for overlap in OVERLAPS:
            ways[BY_CLOSEST, f"overlap {overlap:g}"] = partial(
                register_by_closest_points, trial.scan, surface, trial.start, overlap=overlap
            )
        for (method, setting), run in ways.items():
            since = time.process_time()
            try:
                pose = run()
            except RonnaError as error:
                if method == OURS:
                    refused[name] = error.code
                continue
            finally:
                seconds[method] = seconds.get(method, 0.0) + time.process_time() - since
            error_mm = _error_mm(pose.as_matrix(), trial, targets)
            found.setdefault(method, {}).setdefault(setting, {})[name] = round(error_mm, 4)
    return found, seconds, refused


def _ours(trial: Trial, surface: HeadInCt, targets: Array) -> Transform:
    return register_surface(trial.scan, surface, trial.start, targets_ct_mm=targets).robot_from_ct


def _add_peers(found: Results, seconds: dict[str, float], poses: Path, study: SurfaceStudy) -> None:
    """Add the errors of the poses that the peers wrote."""
    truths: dict[str, tuple[Trial, Array]] = {}
    for unit in study.units():
        in_ct, trial, _ = draw_unit(study.seed, unit)
        truths[scan_name(unit)] = trial, _targets(study, unit, in_ct)
    for line in poses.read_text(encoding="utf-8").splitlines():
        one: dict[str, Any] = json.loads(line)
        trial, targets = truths[one["scan"]]
        error_mm = _error_mm(np.linalg.inv(np.array(one["ct_from_robot"])), trial, targets)
        found.setdefault(one["method"], {}).setdefault(one["setting"], {})[one["scan"]] = round(error_mm, 4)
        seconds[one["method"]] = seconds.get(one["method"], 0.0) + one["cpu_s"]


def _targets(study: SurfaceStudy, unit: Unit, in_ct: HeadInCt) -> Array:
    return np.concatenate(list(in_ct.targets_mm(generator(study.seed + TARGETS_SEED, unit)).values()))


def _error_mm(robot_from_ct: Array, trial: Trial, targets: Array) -> float:
    """Return the mean error over the targets."""
    placed = targets @ robot_from_ct[:3, :3].T + robot_from_ct[:3, 3]
    return float(np.linalg.norm(placed - trial.truth.apply(targets), axis=1).mean())


def _table(
    found: Results, seconds: Mapping[str, float], names: Sequence[str], refused: Mapping[str, str]
) -> Table:
    accepted = [name for name in names if name not in refused]
    rows: list[dict[str, Cell]] = []
    for method, settings in found.items():
        setting = min(settings, key=lambda one: _mean(settings[one], accepted))
        errors = settings[setting]
        shown = [errors[name] for name in accepted if name in errors]
        rows.append(
            {
                "method": method,
                "best setting": setting,
                "clouds": len(shown),
                "mean mm": float(np.mean(shown)) if shown else None,
                "median mm": float(np.median(shown)) if shown else None,
                "95th percentile mm": float(np.percentile(shown, 95.0)) if shown else None,
                "beyond 5 mm": sum(one > FAR_MM for one in shown),
                "mean mm where ours refuses": _mean(errors, refused) if method != OURS else None,
                "ms of processor": 1000.0 * seconds[method] / len(names) / len(settings),
            }
        )
    rows.sort(key=lambda row: float(str(row["mean mm"])) if row["mean mm"] is not None else np.inf)
    return Table.of(
        "The same clouds",
        rows,
        f"{len(names)} clouds, of which ours refused {len(refused)}. Mean of six targets each. The setting "
        "of a peer is the one with the least mean error here. Times with one thread, without building trees.",
    )


def _mean(errors: Mapping[str, float], names: Iterable[str]) -> float:
    """Return the mean over some clouds; infinite if there is none."""
    shown = [errors[name] for name in names if name in errors]
    return float(np.mean(shown)) if shown else float("inf")


if __name__ == "__main__":
    main()
