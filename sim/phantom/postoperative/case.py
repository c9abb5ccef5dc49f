"""Writes the postoperative CT, and its truth."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ronna_hw.records import write_whole
from sim.phantom.case import SERIES_FOLDER, TRUTH_FILE, WORKERS, Progress
from sim.phantom.postoperative.instruments import Instrument
from sim.phantom.postoperative.scan import PostoperativeScan
from sim.phantom.scanner.dicom_series import DicomSeries, stored_values
from sim.world.rigid import apply


@dataclass(frozen=True)
class PostoperativeCase:
    """What was written."""

    series: Path
    truth: Path
    series_instance_uid: str
    slices: int


def write_postoperative(
    scan: PostoperativeScan,
    instruments: tuple[Instrument, ...],
    folder: Path,
    progress: Progress = lambda share: None,
) -> PostoperativeCase:
    """Scan the head again; the truth is written last, so a folder that has it has a complete series."""
    grid = scan.grid
    series = DicomSeries(
        scan.scene.model_copy(update={"ct": scan.protocol}),
        grid,
        folder / SERIES_FOLDER,
        occasion=f"after the operation, {scan.seed}, {instruments}",
    )
    series.prepare()

    def paint(number: int) -> NDArray[np.uint16]:
        return stored_values(scan.paint(number))

    with ThreadPoolExecutor(WORKERS) as pool:
        for number, stored in enumerate(pool.map(paint, range(grid.slices))):
            series.write(number, stored)
            progress((number + 1) / grid.slices)
    truth = folder / TRUTH_FILE
    content = postoperative_truth(scan, instruments, series.series_instance_uid)
    write_whole(truth, json.dumps(content, indent=1).encode())
    return PostoperativeCase(folder / SERIES_FOLDER, truth, series.series_instance_uid, grid.slices)


def postoperative_truth(
    scan: PostoperativeScan, instruments: tuple[Instrument, ...], series_instance_uid: str
) -> dict[str, Any]:
    """Where everything is, in the CT frame of the plan and in that of the new scan."""
    post_from_pre = scan.pose.scan_from_head
    return {
        "scene": scan.scene.name,
        "seed": scan.seed,
        "series_instance_uid": series_instance_uid,
        "post_from_pre": post_from_pre.tolist(),
        "instruments": [
            {
                "id": one.identifier,
                "kind": one.kind.value,
                "tip_mm": list(one.tip_mm),
                "outwards": list(one.outwards),
                "tip_in_scan_mm": apply(post_from_pre, one.tip_mm).tolist(),
            }
            for one in instruments
        ],
    }
