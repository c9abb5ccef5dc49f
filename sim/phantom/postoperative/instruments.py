"""What a run left in the head, from its truth: the guide's tip and axis at every target."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.errors import NothingToVerify
from sim.phantom.head.anatomy import METAL_HU
from sim.phantom.head.layers import LAYERS
from sim.phantom.head.shapes import Point, Rod
from sim.world.rigid import apply, inverse, matrix_of
from sim.world.scene.model import Head, Scene, read_scene
from sim.world.truth import SCENE_FILE, THEATRE_FOLDER, read_samples

Array = NDArray[np.float64]

ABOVE_SKIN_MM = 25.0  # length of an instrument outside the head
FLUID_HU = 15.0  # in a drilled hole: blood and cerebrospinal fluid
BELOW_SKULL_MM = 1.5  # overshoot of a drill beyond the inner table
TO_BRAIN_MM = sum(thickness for thickness, _ in LAYERS[:6])  # skin to the inside of the skull


class Kind(StrEnum):
    """What is in the head when it is scanned."""

    ELECTRODE = "electrode"
    NEEDLE = "needle"
    DRILL_HOLE = "drill-hole"


# Typical sizes: a lead of 1.27 mm, a biopsy needle of 1.8 mm, a twist drill of 3.2 mm.
RADII_MM = {Kind.ELECTRODE: 0.635, Kind.NEEDLE: 0.9, Kind.DRILL_HOLE: 1.6}


@dataclass(frozen=True)
class Instrument:
    """One trajectory as actually carried out, CT frame of the plan: tip, and unit vector out of the head."""

    identifier: str
    kind: Kind
    tip_mm: Point
    outwards: Point

    def rod(self, head: Head) -> Rod:
        """The body to paint; a drilled hole is filled with fluid, and as deep as the skull."""
        skin_mm = _to_skin_mm(self, head)
        if self.kind is not Kind.DRILL_HOLE:
            return Rod(METAL_HU, self.tip_mm, self.outwards, skin_mm + ABOVE_SKIN_MM, RADII_MM[self.kind])
        deep_mm = TO_BRAIN_MM + BELOW_SKULL_MM
        x, y, z = np.add(self.tip_mm, (skin_mm - deep_mm) * np.array(self.outwards)).tolist()
        return Rod(FLUID_HU, (x, y, z), self.outwards, deep_mm, RADII_MM[self.kind])


def instruments_of(run: Path, kind: Kind) -> tuple[Scene, tuple[Instrument, ...]]:
    """The scene of a run and what it left at the targets reached. Raises SIM-006, SIM-007."""
    theatre = run / THEATRE_FOLDER
    if not (theatre / SCENE_FILE).is_file():
        raise NothingToVerify(f"{run} has no simulated theatre")
    scene = read_scene(theatre / SCENE_FILE)
    samples = {sample.target: sample for sample in read_samples(theatre)}  # the last one of each target
    if not samples:
        raise NothingToVerify(f"{run} reached no target")
    robot_from_ct = matrix_of(scene.head.robot_from_ct)
    found = []
    for identifier, sample in samples.items():
        ct_from_robot = inverse(sample.head_moved @ robot_from_ct)
        tip = apply(ct_from_robot, sample.tip_mm)
        inwards = ct_from_robot[:3, :3] @ np.array(sample.axis)
        found.append(Instrument(identifier, kind, _point(tip), _point(-inwards / np.linalg.norm(inwards))))
    return scene, tuple(found)


def _to_skin_mm(instrument: Instrument, head: Head) -> float:
    """From the tip outwards to the skin."""
    axes = np.array(head.semi_axes_mm)
    start = np.subtract(instrument.tip_mm, head.centre_ct_mm) / axes
    along = np.array(instrument.outwards) / axes
    a, b, c = along @ along, start @ along, start @ start - 1.0
    if c >= 0.0:
        return 0.0  # the tip is outside the head: the run missed it by far
    return float((np.sqrt(b * b - a * c) - b) / a)


def _point(values: Array) -> Point:
    x, y, z = (float(value) for value in values)
    return x, y, z
