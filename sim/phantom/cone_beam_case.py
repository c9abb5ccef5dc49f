"""Files of a scan during the operation: the series, and its truth."""

from __future__ import annotations

import json
from contextlib import closing
from pathlib import Path

import numpy as np

from ronna_hw.records import write_atomically
from sim.phantom.case import (
    SERIES_FOLDER,
    TRUTH_FILE,
    PostoperativeCase,
    Progress,
    whole_or_removed,
    write_slices,
)
from sim.phantom.cone_beam_scan import KERNEL, OUTSIDE_HU, ConeBeamPainter, ConeBeamScan
from sim.phantom.scan import WIDE_STORED
from sim.phantom.scanner.dicom_series import DicomSeries, to_stored_values
from sim.phantom.scanner.faults import ScannerFaults
from sim.world.displacements import ShiftedRoom, spheres_in_theatre
from sim.world.rigid import apply, as_point, inverse, matrix_of
from sim.world.saved_world import read_saved_world
from sim.world.scene.model import Fiducial, Scene, read_scene
from sim.world.truth import SCENE_FILE
from sim.world.world import World

SCAN_DATE = "20180602"  # the day after the planning CT
INTERCEPT_HU = round(OUTSIDE_HU)


def head_in_theatre(theatre: Path) -> tuple[Scene, tuple[Fiducial, ...]]:
    """Return the scene of a theatre's folder and the spheres on the head as they are now, in the CT frame.

    Raises SIM-003, SIM-012 unless a theatre was started there.
    """
    saved = read_saved_world(theatre)
    scene = read_scene(theatre / SCENE_FILE)
    return scene, _spheres_now(saved.restore(scene, paced=False))


def _spheres_now(world: World) -> tuple[Fiducial, ...]:
    """Return the refitted spheres where faults of the room have left them on the head, in the CT frame."""
    spheres = spheres_in_theatre(world.scene)
    robot_from_ct = matrix_of(world.scene.head.robot_from_ct)
    room = ShiftedRoom(world).now()
    places_mm = apply(robot_from_ct, np.array([one.centre_ct_mm for one in spheres]))
    alone = {number: np.array(by_mm) for number, by_mm in room.spheres_mm}
    moved_mm = [
        place + alone.get(one.number, np.zeros(3)) for one, place in zip(spheres, places_mm, strict=True)
    ]
    in_ct_mm = apply(inverse(robot_from_ct), np.array(moved_mm))
    return tuple(
        one.model_copy(update={"centre_ct_mm": as_point(place)})
        for one, place in zip(spheres, in_ct_mm, strict=True)
    )


def write_cone_beam(
    scan: ConeBeamScan, folder: Path, progress: Progress = lambda share: None
) -> PostoperativeCase:
    """Write a scan, its truth last so that its presence marks a complete series."""
    grid, painter = scan.grid, ConeBeamPainter(scan)
    series = DicomSeries(
        scan.scene.model_copy(update={"ct": scan.protocol}),
        grid,
        folder / SERIES_FOLDER,
        ScannerFaults(extended_range=True),
        occasion=f"during the operation, {scan.seed}, {[one.fiducial.centre_ct_mm for one in scan.markers]}",
        described="Head phantom in the clamp",
        date=SCAN_DATE,
        intercept_HU=INTERCEPT_HU,
        kernel_name=KERNEL.name,
    )
    painter.paint_patches()  # before the fork that writes half of the slices
    with (
        whole_or_removed(series, folder / SERIES_FOLDER),
        closing(
            write_slices(
                series,
                grid,
                lambda number: to_stored_values(painter.paint(number), WIDE_STORED, INTERCEPT_HU),
            )
        ) as counts,
    ):
        for count in counts:
            progress(count / grid.slices)
    truth = folder / TRUTH_FILE
    content = {
        "scene": scan.scene.name,
        "seed": scan.seed,
        "series_instance_uid": series.series_instance_uid,
        "scan_from_ct": scan.pose.scan_from_head.tolist(),
        "fiducials": [
            {
                "number": marker.fiducial.number,
                "centre_mm": list(marker.fiducial.centre_ct_mm),
                "radius_mm": marker.fiducial.radius_mm,
                "post_material": marker.post,
                "shown": round(scan.share_shown(marker), 3),
            }
            for marker in scan.markers
        ],
        "targets": [
            {"id": one.identifier, "target_mm": apply(scan.pose.scan_from_head, one.target_ct_mm).tolist()}
            for one in scan.scene.head.targets
        ],
    }
    write_atomically(truth, json.dumps(content, indent=1).encode())
    return PostoperativeCase(folder / SERIES_FOLDER, truth, series.series_instance_uid, grid.slices)
