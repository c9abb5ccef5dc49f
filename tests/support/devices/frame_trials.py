"""Motions watched frame by frame, in this process: the scene's spheres with the tracker's bias and noise."""

from __future__ import annotations

from functools import cache

import numpy as np

from procedures.guards.head_frames import PATIENT_LIMIT_MM, HeadFrames
from procedures.guards.watch_thread import SKIPPED_FRAMES
from ronna_hw.arrays import Array
from ronna_hw.devices.readings import Stamp, StrayReading, TrackerFrame, Validity
from sim.polaris.measurement.optics import Optics
from sim.polaris.unit.model import SPECTRA
from sim.world.rigid import apply, inverse, matrix_of
from sim.world.scene.named_scenes import draw_scene

SCENES = 20
MOTION_FRAMES = 180  # three seconds, as onto a target
BEFORE_FRAMES = 60  # the watch's last readings are of earlier motions
LOCALIZATION_FRAMES = 60
UNTIL_ORDERED = 1  # frames that may pass from an alarm to the stop command: the next is held until it is read


def frames_to_alarm(trial: int, head_mm: float, hidden: float = 0.0) -> int | None:
    """Frames from a shift of the head at a random moment of a motion to the stop command; None for none.

    Three spheres in every second trial, five in the others. A shift of 0 is a quiet motion. In each frame
    each sphere is hidden with that probability.
    """
    generator = np.random.default_rng([trial, round(1000 * head_mm), 12])
    spheres_mm, optics = _scene(trial % SCENES, "mini" if trial % 2 else "default")
    way = generator.standard_normal(3)
    way *= head_mm / np.linalg.norm(way)
    still, moved = optics.sight(spheres_mm), optics.sight(spheres_mm + way)
    noise = generator.standard_normal(spheres_mm.shape) / np.sqrt(LOCALIZATION_FRAMES)
    head = HeadFrames(still.measured(noise))
    shift = BEFORE_FRAMES + int(generator.integers(MOTION_FRAMES))
    frame, last = 0, BEFORE_FRAMES + 2 * MOTION_FRAMES
    while frame < last:
        sight = moved if frame >= shift else still
        places_mm = sight.measured(generator.standard_normal(spheres_mm.shape))
        if hidden:
            places_mm = places_mm[generator.random(len(places_mm)) >= hidden]
        head.add_frame(shuffled_frame(places_mm, generator))
        if head.moved_mm is not None and head.moved_mm >= PATIENT_LIMIT_MM:
            return frame - shift + UNTIL_ORDERED
        frame += 1 if head.doubtful else 1 + SKIPPED_FRAMES
    return None


def shuffled_frame(places_mm: Array, generator: np.random.Generator) -> TrackerFrame:
    """A frame that shows spheres (n, 3) in any order."""
    shuffled = generator.permutation(places_mm).tolist()
    strays = tuple(StrayReading((x, y, z), Validity.OK) for x, y, z in shuffled)
    return TrackerFrame(Stamp(1, 0, 0.0), Validity.OK, (), strays)


@cache
def _scene(seed: int, name: str) -> tuple[Array, Optics]:
    scene = draw_scene("mini" if name == "mini" else "default", seed=seed)
    tracker_from_ct = inverse(matrix_of(scene.tracker.robot_from_tracker)) @ matrix_of(
        scene.head.robot_from_ct
    )
    spheres_mm = apply(tracker_from_ct, [each.centre_ct_mm for each in scene.head.fiducials])
    return spheres_mm, Optics(scene.tracker, seed, SPECTRA.volumes)
