"""Measurements shared by all arms: CT scans of the phantom, the tool's tip, the registration.

A person pivots the tool in a divot beside the phantom. The tracker then sees the phantom's spheres and its
frame at the same time, so that the CT is registered to that frame and the phantom may be moved.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, ValidationError
from scipy.spatial.transform import RigidTransform

from procedures.calibration.pose_set import plan_poses_about
from procedures.imaging import localize, read_series
from procedures.registration import match, register
from procedures.workcell.patient_frame import as_patient
from procedures.workcell.tracker_look import mean_pose
from ronna_hw.arrays import Array
from ronna_hw.bounded_input import read_json_bytes
from ronna_hw.calibration import Numbers3, PoseRecord, Strict
from ronna_hw.devices.sensors import OpticalTracker, new_frames
from ronna_hw.devices.strays import average_strays
from ronna_hw.frames import Frame, Transform
from ronna_hw.records import write_atomically
from sim.world.noise import noise
from sim.world.rigid import pose_of
from sim.world.scene.model import CtProtocol, Scene
from sim.world.scene.named_scenes import MINI_CT
from studies.errors import LEDGER_UNREADABLE, OTHER_STUDY, TRACKER_NOT_SIMULATED
from studies.localization.phantom_scans import run_phantom
from studies.low_cost.calibration import fit_pivot
from studies.low_cost.devices import FRAME_LIMIT_S, PHANTOM_FRAME, Hand, open_room, require_look
from studies.low_cost.room import draw_room, drawn_marker_in_tip, phantom_centre_mm
from studies.low_cost.targets import REFERENCE
from studies.sphere_errors import LARGEST_FEED_ERROR

FILE = "preparation.json"
SCANNER_KEY = "low-cost scanner"  # of random numbers
PIVOTS = 40
PIVOT_TILT_RAD, PIVOT_TURN_RAD = math.radians(30.0), math.radians(40.0)
DIVOT_FROM_CENTRE_MM = (120.0, 40.0, 40.0)
REGISTRATION_FRAMES = 100  # 5 s
# Per axis, for the pairing: of a sphere in the CT, and of its mean in the tracker.
SPHERE_SIGMA_MM = (0.1, 0.3)


class Preparation(Strict):
    """Results that do not depend on the arm."""

    seed: int = Field(description="Seed of the room.")
    frames: int = Field(description="Frames averaged for one look.")
    coarse: bool = Field(description="Scans of larger voxels.")
    scans_mm: tuple[tuple[Numbers3, ...], ...] = Field(description="Spheres found in each scan, CT frame.")
    tip_in_marker_mm: Numbers3 = Field(description="Tip of the tool in its frame, from pivoting.")
    pivot_rms_mm: Annotated[float, Field(ge=0)] = Field(description="Residual of pivoting.")
    patient_from_ct: PoseRecord = Field(description="Registration of the first scan.")
    fre_mm: Annotated[float, Field(ge=0)] = Field(description="Residual of the registration, rms.")

    @property
    def tip_from_marker(self) -> Transform:
        """Pose TOOL <- MARKER: place from pivoting, orientation by the drawing."""
        turn = drawn_marker_in_tip().rigid.rotation
        moved = RigidTransform.from_components(-turn.apply(self.tip_in_marker_mm), turn)
        return Transform(Frame.TOOL, Frame.MARKER, moved)

    @property
    def registration(self) -> Transform:
        return self.patient_from_ct.transform(Frame.PATIENT, Frame.CT)


def load_or_prepare(
    folder: Path,
    seed: int,
    scans: int,
    frames: int,
    *,
    coarse: bool = False,
    progress: Callable[[float], None] = lambda share: None,
) -> Preparation:
    """Return the results stored in the study's folder, measuring them first if necessary.

    `coarse`: scans of larger voxels, in a tenth of the time. Raises STU-001, STU-002, STU-006, STU-008.
    """
    path = folder / FILE
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)  # first: what takes minutes must not be lost
        found = prepare(seed, scans, frames, coarse=coarse, progress=progress)
        write_atomically(path, found.model_dump_json(indent=1).encode())
        return found
    try:
        found = Preparation.model_validate_json(read_json_bytes(path), strict=False)
    except (OSError, ValueError, ValidationError) as error:
        raise LEDGER_UNREADABLE(f"{path} is damaged: {error}") from error
    if (found.seed, len(found.scans_mm), found.frames, found.coarse) != (seed, scans, frames, coarse):
        raise OTHER_STUDY(
            f"{folder} was prepared with other settings",
            expected=f"seed {seed}, {scans} scans, {frames} frames, coarse {coarse}",
            got=f"seed {found.seed}, {len(found.scans_mm)} scans, {found.frames} frames, "
            f"coarse {found.coarse}",
        )
    return found


def prepare(
    seed: int,
    scans: int,
    frames: int,
    *,
    coarse: bool,
    progress: Callable[[float], None] = lambda share: None,
) -> Preparation:
    """Scan the phantom, pivot the tool, and register the first scan. Raises STU-006, STU-008."""
    scene = draw_room(seed)
    scans_mm = []
    for number in range(scans):
        scans_mm.append(_scan(scene, number, MINI_CT if coarse else scene.ct))
        progress((number + 1) / (scans + 1))
    with open_room(scene) as (world, tracker):
        spheres_mm = _read_spheres(tracker)
        hand, poses = Hand(world), []
        divot_mm = phantom_centre_mm(scene) + DIVOT_FROM_CENTRE_MM
        for look in plan_poses_about(
            REFERENCE, divot_mm, PIVOTS, tilt_rad=PIVOT_TILT_RAD, turn_rad=PIVOT_TURN_RAD
        ):
            hand.hold(look.pose.as_matrix())
            poses.append(require_look(tracker, frames).patient_from_marker)
    pivot = fit_pivot(poses)
    found = match(
        scans_mm[0],
        spheres_mm,
        sigma_image_mm=SPHERE_SIGMA_MM[0],
        sigma_physical_mm=SPHERE_SIGMA_MM[1],
        expected=len(scene.head.fiducials),
    )
    if found.pairs is None or not len(found.pairs):
        raise TRACKER_NOT_SIMULATED(f"the phantom's spheres are not paired: {found.reason}")
    image, physical = np.asarray(found.pairs).T
    registered = register(scans_mm[0][image], spheres_mm[physical])
    x, y, z = pivot.tip_mm.tolist()
    return Preparation(
        seed=seed,
        frames=frames,
        coarse=coarse,
        scans_mm=tuple(tuple((x, y, z) for x, y, z in one.tolist()) for one in scans_mm),
        tip_in_marker_mm=(x, y, z),
        pivot_rms_mm=pivot.rms_mm,
        patient_from_ct=pose_of(registered.transform.as_matrix()),
        fre_mm=registered.fre_mm,
    )


def _scan(scene: Scene, number: int, protocol: CtProtocol) -> Array:
    """Scan the phantom once more, and return the spheres found (n, 3). Raises STU-006."""
    drawn = scene.model_copy(update={"seed": scene.seed + number, "ct": protocol})
    feed = float(noise(scene.seed, SCANNER_KEY, number).uniform(-1.0, 1.0)) * LARGEST_FEED_ERROR
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.json"
        write_atomically(file, drawn.model_dump_json(by_alias=True).encode())
        out = str(Path(folder) / "scan")
        scanned = run_phantom(
            f"scan {number}", "--scene", str(file), "--out", out, "--table-scale", f"{feed:.6f}"
        )
        return localize(read_series(Path(scanned["series"]))).centres_mm


def _read_spheres(tracker: OpticalTracker) -> Array:
    """Return the mean positions (n, 3) of the phantom's spheres in its frame, without the tool in view."""
    read = list(new_frames(tracker, REGISTRATION_FRAMES, timeout_s=FRAME_LIMIT_S))
    phantom = mean_pose(read, PHANTOM_FRAME, REGISTRATION_FRAMES // 2)
    if phantom is None:
        raise TRACKER_NOT_SIMULATED("the tracker does not see the phantom's frame")
    spheres = np.array([group.mean_mm for group in average_strays(read).groups])
    return np.asarray(as_patient(phantom).inverse().apply(spheres.reshape(-1, 3)))
