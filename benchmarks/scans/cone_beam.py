"""Scans during the operation against phantom ground truth: each sphere's error, and the place in the CT.

Families and seeds are fixed here, and were before the first run of these seeds: `aimed` has the whole of
most spheres in the field, `off` misses them by up to 35 mm per axis, `noisy` has twice the noise. Development
used seeds 1000 to 1012. The first scans of `aimed` are also placed in a CT of the head made before the
spheres were refitted. Run from the repository root; a folder that holds results is continued:

    python -m benchmarks.scans.cone_beam FOLDER
"""

from __future__ import annotations

import argparse
import json
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.localization import localize
from procedures.imaging.markers import CUT_BY_FIELD, STREAKED, Localization
from procedures.imaging.volume import Volume, VoxelGeometry
from procedures.intraoperative.bone_pose import register_bone
from procedures.intraoperative.placement import ScannedSpheres, place_scan
from ronna_hw.arrays import Array
from ronna_hw.errors import RonnaError
from ronna_hw.records import write_atomically
from sim.phantom.cone_beam_scan import PROTOCOL, ConeBeamPainter, ConeBeamScan, draw_cone_beam
from sim.phantom.scan import Planes, plain_scan
from sim.phantom.scanner.dicom_series import INTERCEPT_HU, to_stored_values
from sim.phantom.scanner.grid import CtGrid
from sim.world.displacements import spheres_in_theatre
from sim.world.rigid import apply, inverse
from sim.world.scene.model import Scene
from sim.world.scene.named_scenes import draw_scene

SAME_SPHERE_MM = 2.0
SEATING_MM = 0.05  # per axis, that a theatre file states
HU_LIMITS = (-2048, 32767)


@dataclass(frozen=True)
class Family:
    """Scans of one kind: their seeds, the error of the aim per axis, the noise."""

    seeds: range
    aim_mm: float
    noise_HU: float
    placed: int = 0  # how many of them are also placed in the planning CT


FAMILIES = {
    "aimed": Family(range(2000, 2010), 8.0, 60.0, placed=4),
    "off": Family(range(2100, 2104), 35.0, 60.0),
    "noisy": Family(range(2200, 2204), 8.0, 120.0),
}


def volume_of(grid: CtGrid, voxels: NDArray[np.int16], uid: str) -> Volume:
    spacing = np.array([grid.slice_mm, grid.pixel_mm, grid.pixel_mm])
    geometry = VoxelGeometry(voxels.shape, np.array(grid.origin_mm), np.eye(3)[:, ::-1], spacing)
    return Volume(voxels, geometry, uid, uid)


def paint_cone_beam(scan: ConeBeamScan) -> Volume:
    painter, count = ConeBeamPainter(scan), scan.grid.slices
    planes = (np.clip(np.rint(painter.paint(number)), *HU_LIMITS) for number in range(count))
    return volume_of(scan.grid, np.stack([one.astype(np.int16) for one in planes]), "1.2.2")


def paint_ct(scene: Scene) -> Volume:
    scan = plain_scan(scene)
    planes = Planes(scan)
    with ThreadPoolExecutor(1) as pool:
        planes.paint_patches(pool)
    stored = (to_stored_values(planes.paint(number)) for number in range(scan.grid.slices))
    return volume_of(
        scan.grid,
        np.stack([(one.astype(np.int32) + INTERCEPT_HU).astype(np.int16) for one in stored]),
        "1.2.1",
    )


def judge_spheres(scan: ConeBeamScan, found: Localization) -> dict[str, Any]:
    """Compare what was found with the truth, sphere by sphere."""
    true_mm = np.array([marker.fiducial.centre_ct_mm for marker in scan.markers])
    rows, false = {}, 0
    for marker in found.markers:
        off_mm = np.linalg.norm(true_mm - marker.centre_mm, axis=1)
        nearest = int(off_mm.argmin())
        if off_mm[nearest] > SAME_SPHERE_MM:
            false += 1
            continue
        error = np.array(marker.centre_mm) - true_mm[nearest]
        square = float(error @ np.linalg.solve(np.array(marker.covariance_mm2), error)) / 3.0
        rows[nearest] = {
            "error_mm": round(float(off_mm[nearest]), 4),
            "sigma_mm": round(marker.sigma_mm, 4),
            "normalized_square": round(square, 3),
            "cut": CUT_BY_FIELD in marker.flags,
            "streaked": STREAKED in marker.flags,
        }
    doubtful_mm = np.array([one.centre_mm for one in found.candidates if not one.accepted]).reshape(-1, 3)
    reasons = [one.reason for one in found.candidates if not one.accepted]
    spheres = []
    for number, there in enumerate(scan.markers):
        own = {
            "number": there.fiducial.number,
            "post": there.post,
            "shown": round(scan.share_shown(there), 3),
        }
        if number not in rows:
            near_mm = np.linalg.norm(doubtful_mm - true_mm[number], axis=1)
            listed = near_mm.size and near_mm.min() < SAME_SPHERE_MM
            own["listed_as"] = reasons[int(near_mm.argmin())] if listed else ""
        spheres.append(own | rows.get(number, {}))
    return {"spheres": spheres, "false": false}


def judge_place(scene: Scene, scan: ConeBeamScan, volume: Volume, found: Localization) -> dict[str, Any]:
    """Place a scan in the CT, and compare the targets with the truth."""
    ct = paint_ct(scene)
    before = localize(ct)
    targets_mm = np.array([target.target_ct_mm for target in scene.head.targets])
    in_scan_mm = apply(scan.pose.scan_from_head, targets_mm)
    bone = register_bone(ct, volume)
    placed = place_scan(
        bone.pose,
        ScannedSpheres(found.centres_mm, found.covariances_mm2),
        ScannedSpheres(before.centres_mm, before.covariances_mm2),
        SEATING_MM,
    )

    def compare(pose: Any) -> dict[str, list[float]]:
        off_mm = pose.ct_from_scan.apply(in_scan_mm) - targets_mm
        expected = pose.covariances_mm2(targets_mm)
        squares = np.einsum("ni,ni->n", off_mm, np.linalg.solve(expected, off_mm[..., None])[..., 0]) / 3.0
        return {
            "error_mm": np.linalg.norm(off_mm, axis=1).round(4).tolist(),
            "expected_mm": np.sqrt(np.trace(expected, axis1=1, axis2=2)).round(4).tolist(),
            "normalized_square": squares.round(3).tolist(),
        }

    places_mm = placed.pose.ct_from_scan.apply(found.centres_mm)
    true_mm = apply(
        inverse(scan.pose.scan_from_head), np.array([one.fiducial.centre_ct_mm for one in scan.markers])
    )
    return {
        "agreement": round(bone.agreement, 4),
        "agreeing_starts": bone.agreeing_starts,
        "by_bone": compare(bone.pose),
        "by_both": compare(placed.pose),
        "agreeing_spheres": placed.agreeing,
        "spheres_in_ct_error_mm": _nearest_mm(places_mm, true_mm),
    }


def _nearest_mm(places_mm: Array, true_mm: Array) -> list[float]:
    apart = np.linalg.norm(places_mm[:, None] - true_mm[None], axis=2).min(axis=1)
    return [round(float(one), 4) for one in apart]


def summarize(scans: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Summarize one family."""
    spheres = [one for scan in scans.values() for one in scan["spheres"]]
    found = [one for one in spheres if "error_mm" in one]
    whole = [one for one in spheres if one["shown"] >= 1.0]
    summary: dict[str, Any] = {
        "scans": len(scans),
        "spheres": len(spheres),
        "whole": len(whole),
        "found": len(found),
        "whole_found": sum("error_mm" in one for one in whole),
        "missed_whole": sum("error_mm" not in one for one in whole),
        "missed_whole_listed": sum("error_mm" not in one and bool(one["listed_as"]) for one in whole),
        "cut_found": sum("error_mm" in one for one in spheres if one["shown"] < 1.0),
        "cut_found_unflagged": sum(
            "error_mm" in one and not one["cut"] for one in spheres if one["shown"] < 1.0
        ),
        "false": sum(scan["false"] for scan in scans.values()),
        "refused": sum("refused" in scan for scan in scans.values()),
    }
    if found:
        errors = np.array([one["error_mm"] for one in found])
        summary |= {
            "rms_mm": round(float(np.sqrt(np.mean(errors**2))), 4),
            "largest_mm": round(float(errors.max()), 4),
            "stated_rms_mm": round(float(np.sqrt(np.mean([one["sigma_mm"] ** 2 for one in found]))), 4),
            "normalized_square": round(float(np.mean([one["normalized_square"] for one in found])), 3),
        }
    placed = [scan["place"] for scan in scans.values() if "by_both" in scan.get("place", {})]
    for name in ("by_bone", "by_both") if placed else ():
        errors = np.array([error for one in placed for error in one[name]["error_mm"]])
        squares = [square for one in placed for square in one[name]["normalized_square"]]
        summary[name] = {
            "targets": len(errors),
            "mean_mm": round(float(errors.mean()), 4),
            "largest_mm": round(float(errors.max()), 4),
            "normalized_square": round(float(np.mean(squares)), 3),
        }
    return summary


def draw_of(family: Family, seed: int) -> tuple[Scene, ConeBeamScan]:
    scene = draw_scene("default", seed=seed)
    protocol = PROTOCOL.model_copy(update={"noise_HU": family.noise_HU})
    scan = draw_cone_beam(scene, spheres_in_theatre(scene), seed, protocol=protocol, aim_mm=family.aim_mm)
    return scene, scan


def run_scan(family: Family, seed: int) -> dict[str, Any]:
    _, scan = draw_of(family, seed)
    volume = paint_cone_beam(scan)
    try:
        found = localize(volume)
    except RonnaError as refused:
        spheres = [
            {"number": one.fiducial.number, "post": one.post, "shown": scan.share_shown(one), "listed_as": ""}
            for one in scan.markers
        ]
        return {"spheres": spheres, "false": 0, "refused": refused.code}
    return judge_spheres(scan, found)


def run_place(family: Family, seed: int) -> dict[str, Any]:
    scene, scan = draw_of(family, seed)
    volume = paint_cone_beam(scan)
    try:
        return judge_place(scene, scan, volume, localize(volume))
    except RonnaError as refused:
        return {"refused": refused.code}


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("folder", type=Path)
    folder = options.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    kept = folder / "scans.json"
    results: dict[str, Any] = json.loads(kept.read_text()) if kept.exists() else {"families": {}}

    def keep(name: str, began_s: float) -> None:
        entry = results["families"][name]
        entry["summary"] = summarize(entry["scans"])
        results["processor_s"] = round(results.get("processor_s", 0.0) + time.process_time() - began_s, 1)
        write_atomically(kept, (json.dumps(results, indent=1) + "\n").encode())
        print(name, json.dumps(entry["summary"]), flush=True)

    # Families in turn, in proportion, so that a run that is ended early has some of each.
    turns = sorted(
        (number / len(family.seeds), name, seed)
        for name, family in FAMILIES.items()
        for number, seed in enumerate(family.seeds)
    )
    for _, name, seed in turns:
        scans = results["families"].setdefault(name, {"scans": {}})["scans"]
        if str(seed) not in scans:
            began_s = time.process_time()
            scans[str(seed)] = run_scan(FAMILIES[name], seed)
            keep(name, began_s)
    for name, family in FAMILIES.items():
        for seed in family.seeds[: family.placed]:
            scan = results["families"][name]["scans"][str(seed)]
            if "place" not in scan:
                began_s = time.process_time()
                scan["place"] = run_place(family, seed)
                keep(name, began_s)


if __name__ == "__main__":
    main()
