"""The study's scans, heads and truths as files, a benchmark for the registrations of others."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from procedures.exchange.surface_files import encode_ply, encode_scan_ply
from ronna_hw.records import write_atomically
from studies.campaign.study import Unit, generator
from studies.surface.heads import HeadInCt, draw_head
from studies.surface.scanning import AIM_BELOW_MM, AWAY_MM, CAMERAS_RAD, STRAY_MM, STRAY_SHARE
from studies.surface.study import TARGETS_SEED, SurfaceStudy, draw_unit, head_of

HEAD_SPACING_MM = 1.5  # about that of a mesh from a CT

README = """# Scans of heads by a laser line, with truth

Written by `ronna-campaign surface --export`, seed {seed}: {cases} scans of {heads} heads. All heads are
parametric and belong to nobody. Licence: Apache-2.0, as the program.

- `heads/*.ply`: samples of the skin with outward normals, in the CT frame: DICOM patient coordinates (LPS: x
  to the left, y to the back, z up), mm.
- `scans/NAME.ply`: points of a scan in the robot frame, mm, each with the covariance of its noise, the number
  of the look and of the line, and the place of the projector, in the robot frame as well: `view_x`, `view_y`
  and `view_z`. A look has a projector {away_mm:g} mm from the place (0, 0, -{aim_below_mm:g}) of the CT and
  two cameras at the same distance, {cameras_deg:g} degrees to either side of it; no file has the places of
  the cameras. What the arm errs is not in these scans: all looks of one share its frame.
- No point is marked as a stray. Of all lit points, {stray_share:.0%} are displaced along the ray of the
  projector, by {stray_mm:g} mm standard deviation, which their covariance does not count; and where hair
  stands in between, a point lies somewhere in it. A registration has to find them.
- `cases.json`: for each scan its head, how far the CT shows the skin outside the samples (`level_in_ct_mm`:
  move the samples by it along their normals), and a start by the tracker: `start_robot_from_ct`, a matrix
  (4, 4) that maps CT to robot. It errs from the truth by a turn of `start_turn_rad` about the origin of the
  CT frame and a displacement of `start_mm`: both are the root mean square of the whole, of which each of the
  three axes has a share of 1/sqrt(3).
- `truth.json`: for each scan the true pose `robot_from_ct`, targets in the CT by their depth below the skin,
  and the drawn values: kind of misfit, its size and length, noise. A registration may not read this.

The error is the distance, at each target, between the registered and the true place in the robot frame.
"""


def export_study(study: SurfaceStudy, folder: Path, progress: Callable[[float], None]) -> int:
    """Write all scans of a study with their heads and truths, and return the number of scans."""
    for name in ("heads", "scans"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    cases, truths = {}, {}
    units = study.units()
    heads = sorted({head_of(unit) for unit in units})
    for number in heads:
        _write_head(folder / "heads" / f"{_head_name(number)}.ply", draw_head(study.seed, number))
    for done, unit in enumerate(units, start=1):
        name = scan_name(unit)
        cases[name], truths[name] = _write_case(folder / "scans" / f"{name}.ply", study.seed, unit)
        progress(done / len(units))
    for name, content in (("cases", cases), ("truth", truths)):
        write_atomically(folder / f"{name}.json", json.dumps(content, indent=1).encode())
    text = README.format(
        seed=study.seed,
        cases=len(units),
        heads=len(heads),
        away_mm=AWAY_MM,
        aim_below_mm=AIM_BELOW_MM,
        cameras_deg=np.degrees(CAMERAS_RAD),
        stray_share=STRAY_SHARE,
        stray_mm=STRAY_MM,
    )
    write_atomically(folder / "README.md", text.encode())
    return len(units)


def _write_case(path: Path, seed: int, unit: Unit) -> tuple[dict[str, Any], dict[str, Any]]:
    """Write one scan, and return what a registration may know of it and the truth."""
    in_ct, trial, draw = draw_unit(seed, unit)
    write_atomically(path, encode_scan_ply(trial.scan))
    case = {
        "head": _head_name(head_of(unit)),
        "level_in_ct_mm": draw.offset_mm,
        "start_robot_from_ct": trial.start.robot_from_ct.as_matrix().tolist(),
        "start_turn_rad": trial.start.turn_rad,
        "start_mm": trial.start.place_mm,
    }
    targets = in_ct.targets_mm(generator(seed + TARGETS_SEED, unit))
    truth = {
        "condition": unit.condition,
        "robot_from_ct": trial.truth.as_matrix().tolist(),
        "targets_ct_mm": {depth: places.tolist() for depth, places in targets.items()},
        **asdict(draw),
    }
    return case, truth


def _write_head(path: Path, in_ct: HeadInCt) -> None:
    fine = HeadInCt.sample(in_ct.head, HEAD_SPACING_MM)
    columns = {
        **{name: fine.skin_mm[:, k].astype("<f4") for k, name in enumerate("xyz")},
        **{f"n{name}": fine.normals[:, k].astype("<f4") for k, name in enumerate("xyz")},
    }
    write_atomically(path, encode_ply(columns, "samples of the skin, mm, in the frame ct (LPS)"))


def _head_name(number: int) -> str:
    return f"head-{number:04d}"


def scan_name(unit: Unit) -> str:
    """Return the name of a scan, without its folder."""
    plain = unit.condition.lower().replace("é", "e")
    words = "".join(c if c.isalnum() else " " for c in plain).split()
    return f"{_head_name(unit.block)}-{'-'.join(words)}"
