"""Files of a phantom: CT series, plan and truth, or postoperative series and truth."""

from __future__ import annotations

import json
import os
import shutil
import signal
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ronna_hw.host.child_process import IDLE_TIMEOUT_S, POLL_S, ChildNotReady, ProcessorUse, timeout_error
from ronna_hw.host.forked_process import fork_worker
from ronna_hw.host.process import describe_exit
from ronna_hw.records import write_atomically
from ronna_hw.x_frame import SPHERE_CENTRES_MM
from sim.phantom.head.obstacles import ADHESIVE, FREE, SKIN_ONLY, WITH_SKIN, XFRAME
from sim.phantom.head.shapes import Values
from sim.phantom.mr_scan import MrScan, ct_from_mr
from sim.phantom.postoperative_scan import ImagedInstrument, PostoperativeScan
from sim.phantom.scan import Planes, Scan, plain_scan
from sim.phantom.scanner.dicom_series import (
    DESCRIBED,
    DESCRIBED_BARE,
    LARGEST_STORED,
    PATIENT_POSITION,
    DicomSeries,
    to_stored_values,
)
from sim.phantom.scanner.grid import CtGrid, shown_mm
from sim.world.rigid import apply
from sim.world.scene.model import Scene
from sim.world.scene.plan_feasibility import STANDOFF_MM

SERIES_FOLDER = "ct"
PLAN_FILE = "plan.toml"
TRUTH_FILE = "truth.json"
MR_FOLDER, MR_TRUTH_FILE = "mr", "mr-truth.json"
PLAN_SCHEMA = 1
TOOL = "guide"
INSTRUMENT_LENGTH_MM = 250.0  # a biopsy needle
WORKERS = 2  # NumPy releases the interpreter lock; more would only compete for memory

UPPER_SLICES = "the process that writes the upper slices"

Paint = Callable[[int], NDArray[np.uint16]]  # a slice's stored values, by its number
Progress = Callable[[float], None]


@dataclass(frozen=True)
class PostoperativeCase:
    """Files of a postoperative scan."""

    series: Path
    truth: Path
    series_instance_uid: str
    slices: int


@dataclass(frozen=True)
class PhantomCase(PostoperativeCase):
    """Files of a phantom."""

    plan: Path


def write_case(
    scene: Scene, folder: Path, progress: Progress = lambda share: None, *, scan: Scan | None = None
) -> PhantomCase:
    """Scan the head of a scene and plan trajectories on it; raises SIM-001 if it cannot be scanned.

    `scan` adds surroundings to that head; without it the scene is scanned as it is. Plan and truth are
    written last, so a folder with a plan has a complete series; after an error or an interruption the series
    is removed. Raises PRC-001 if the second process that writes it is killed or halted.
    """
    scan = scan or plain_scan(scene)
    grid = scan.grid
    described = DESCRIBED_BARE if scan.fiducials == SKIN_ONLY else DESCRIBED
    series = DicomSeries(scene, grid, folder / SERIES_FOLDER, scan.faults, described=described)
    planes = Planes(scan)
    paint = mirrored(planes.paint) if scene.ct.mirrored else planes.paint
    steps = planes.steps + grid.slices
    with whole_or_removed(series, folder / SERIES_FOLDER):
        with ThreadPoolExecutor(WORKERS) as pool:
            planes.paint_patches(pool, lambda done: progress(done / steps))
        with closing(
            write_slices(series, grid, lambda number: to_stored_values(paint(number), planes.largest_stored))
        ) as counts:
            for count in counts:
                progress((planes.steps + count) / steps)
    plan, truth = folder / PLAN_FILE, folder / TRUTH_FILE
    write_atomically(truth, json.dumps(_collect_case_truth(scan, series, planes), indent=1).encode())
    write_atomically(plan, plan_toml(scan, series.series_instance_uid).encode())
    return PhantomCase(folder / SERIES_FOLDER, truth, series.series_instance_uid, grid.slices, plan)


def mirrored(paint: Callable[[int], Values]) -> Callable[[int], Values]:
    """Return the same slices with left and right exchanged."""
    return lambda number: np.ascontiguousarray(paint(number)[:, ::-1])


@contextmanager
def whole_or_removed(series: DicomSeries, folder: Path) -> Iterator[None]:
    """Prepare a series for the block; if that ends early, remove the folder made for it, for a repetition."""
    is_new = not folder.exists()
    series.prepare()
    try:
        yield
    except BaseException:  # above all an interruption
        if is_new:
            shutil.rmtree(folder, ignore_errors=True)
        raise


def write_slices(series: DicomSeries, grid: CtGrid, paint: Paint) -> Generator[int]:
    """Write all slices of a series, the upper half in a fork, yielding the count written so far.

    The JPEG-LS encoder keeps the interpreter lock, so threads would take turns at it.
    """
    middle = grid.slices // 2
    own, other = range(middle), range(middle, grid.slices)
    written, report = Pipe(duplex=False)
    process_id = fork_worker(lambda: _report_slices(written, report, series, other, paint))
    report.close()
    reported, use = 0, ProcessorUse(process_id)
    try:
        for number in own:
            series.write(number, paint(number))
            while reported < len(other) and written.poll():
                _receive_slice(written, process_id, use)
                reported += 1
            yield number + 1 + reported
        while reported < len(other):
            _receive_slice(written, process_id, use)
            reported += 1
            yield middle + reported
    finally:
        written.close()
        os.kill(process_id, signal.SIGKILL)
        os.waitpid(process_id, 0)


def _report_slices(
    written: Connection, report: Connection, series: DicomSeries, numbers: range, paint: Paint
) -> None:
    """Write these slices and report each, or the error that ended the work."""
    written.close()  # the parent's end: once that is gone, a report fails
    for number in numbers:
        try:
            series.write(number, paint(number))
        except Exception as error:  # the parent raises it
            report.send(error)
            return
        report.send(None)


def _receive_slice(written: Connection, process_id: int, use: ProcessorUse) -> None:
    """Wait for the next slice that the fork has written; raises the error that ended its work, or PRC-001."""
    while not written.poll(POLL_S):
        if use.idle_s() >= IDLE_TIMEOUT_S:
            raise timeout_error(f"{UPPER_SLICES} does not finish", None)
    try:
        error = written.recv()
    except (EOFError, OSError):
        raise ChildNotReady(
            f"{UPPER_SLICES} ended before they were all written: {_describe_end(process_id)}",
            action="Repeat the command; if the memory ran out, close other programs first.",
        ) from None
    if error is not None:
        raise error


def _describe_end(process_id: int) -> str:
    """Describe how a fork ended, leaving it to be reaped."""
    ended = os.waitid(os.P_PID, process_id, os.WEXITED | os.WNOWAIT)
    if ended is None:
        return "no exit code"
    return describe_exit(ended.si_status if ended.si_code == os.CLD_EXITED else -ended.si_status)


def plan_toml(scan: Scan, series_instance_uid: str, patient_position: str = PATIENT_POSITION) -> str:
    """Return a TOML plan for a scan, with the trajectories of its scene."""
    import tomli_w

    scene = scan.scene
    content = {
        "schema": PLAN_SCHEMA,
        "series_instance_uid": series_instance_uid,
        "patient_orientation": patient_position,
        **_plan_markers(scan),
        **({"template_mm": [list(one) for one in template]} if (template := scene.head.template_mm) else {}),
        "tool": TOOL,
        "standoff_mm": STANDOFF_MM,
        "instrument_length_mm": INSTRUMENT_LENGTH_MM,
        "trajectories": [
            {
                "id": target.identifier,
                "entry_mm": shown_mm(scene, target.entry_ct_mm),
                "target_mm": shown_mm(scene, target.target_ct_mm),
                "free_angle_deg": target.free_angle_deg,
                "margin_mm": target.margin_mm,
            }
            for target in scene.head.targets
        ],
    }
    return tomli_w.dumps(content)


def _plan_markers(scan: Scan) -> dict[str, Any]:
    """Return the plan's marker fields."""
    if scan.fiducials == ADHESIVE:
        return {"implanted": len(scan.scene.head.adhesives), "fiducials": ADHESIVE}
    if scan.fiducials in (FREE, SKIN_ONLY, WITH_SKIN):
        return {"implanted": len(scan.scene.head.fiducials), "fiducials": scan.fiducials}
    return {"implanted": len(SPHERE_CENTRES_MM), "fiducials": XFRAME}


def _collect_case_truth(scan: Scan, series: DicomSeries, planes: Planes) -> dict[str, Any]:
    scene, grid = scan.scene, scan.grid
    streaks = [{"streak_HU": round(one, 1)} for one in planes.streaks_HU()] or [{}] * len(
        scan.anatomy.markers
    )
    return (
        scan.truth
        | planes.active()
        | {
            "scene": scene.name,
            "seed": scene.seed,
            "series_instance_uid": series.series_instance_uid,
            "first_voxel_mm": list(grid.origin_mm),
            "voxel_mm": [grid.pixel_mm, grid.pixel_mm, grid.slice_mm],
            "noise_HU": scene.ct.noise_HU,
            "fiducials": [
                {
                    "number": marker.fiducial.number,
                    "centre_mm": list(marker.fiducial.centre_ct_mm),
                    "radius_mm": marker.fiducial.radius_mm,
                    "post": list(marker.fiducial.post_ct),
                    "post_material": marker.post,
                    "HU": marker.hu,
                    **scan.marks.get(marker.fiducial.number, {}),
                    **streak,
                }
                for marker, streak in zip(scan.anatomy.markers, streaks, strict=True)
            ],
            **(
                {
                    "adhesives": [
                        {"number": one.number, "centre_mm": list(one.centre_ct_mm)}
                        for one in scene.head.adhesives
                    ]
                }
                if scene.head.adhesives
                else {}
            ),
            "targets": [
                {
                    "id": target.identifier,
                    "entry_mm": list(target.entry_ct_mm),
                    "target_mm": list(target.target_ct_mm),
                }
                for target in scene.head.targets
            ],
        }
    )


def write_postoperative(
    scan: PostoperativeScan,
    instruments: tuple[ImagedInstrument, ...],
    folder: Path,
    progress: Progress = lambda share: None,
) -> PostoperativeCase:
    """Rescan the head, writing the truth last so that its presence marks a complete series."""
    grid = scan.grid
    series = DicomSeries(
        scan.scene.model_copy(update={"ct": scan.protocol}),
        grid,
        folder / SERIES_FOLDER,
        occasion=f"after the operation, {scan.seed}, {instruments}",
        described="Head phantom after the operation",
    )
    with (
        whole_or_removed(series, folder / SERIES_FOLDER),
        closing(write_slices(series, grid, lambda number: to_stored_values(scan.paint(number)))) as counts,
    ):
        for count in counts:
            progress(count / grid.slices)
    truth = folder / TRUTH_FILE
    content = postoperative_truth(scan, instruments, series.series_instance_uid)
    write_atomically(truth, json.dumps(content, indent=1).encode())
    return PostoperativeCase(folder / SERIES_FOLDER, truth, series.series_instance_uid, grid.slices)


def write_mr(scan: MrScan, folder: Path, progress: Progress = lambda share: None) -> Path:
    """Write the MR of a phantom beside its CT, its truth last; return the folder of the series."""
    grid, scene = scan.grid, scan.scene.model_copy(update={"ct": scan.protocol})
    series = DicomSeries(
        scene,
        grid,
        folder / MR_FOLDER,
        occasion=f"mr {scan.seed}",
        described="Head phantom before the markers",
        is_mr=True,
    )

    def paint(number: int) -> NDArray[np.uint16]:
        return np.clip(np.rint(scan.paint(number)), 0, LARGEST_STORED).astype("<u2")

    with (
        whole_or_removed(series, folder / MR_FOLDER),
        closing(write_slices(series, grid, paint)) as counts,
    ):
        for count in counts:
            progress(count / grid.slices)
    targets_mm = [target.target_ct_mm for target in scan.scene.head.targets]
    truth = {
        "series_instance_uid": series.series_instance_uid,
        "ct_from_mr": ct_from_mr(scan).tolist(),
        "targets_in_mr_mm": scan.shown_mm(np.array(targets_mm)).tolist(),
    }
    write_atomically(folder / MR_TRUTH_FILE, json.dumps(truth, indent=1).encode())
    return folder / MR_FOLDER


def postoperative_truth(
    scan: PostoperativeScan, instruments: tuple[ImagedInstrument, ...], series_instance_uid: str
) -> dict[str, Any]:
    """Return the pose of the new scan, and the instruments in the CT frames of plan and new scan."""
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
