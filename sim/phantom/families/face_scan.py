"""Scans of heads with a face, in surroundings that hide or change the skin in the CT."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ronna_hw.near_names import did_you_mean
from sim.errors import BAD_SCENE
from sim.phantom.head.anatomy import AIR_HU, draw_anatomy, trough
from sim.phantom.head.obstacles import clamp, cushion
from sim.phantom.head.shapes import Rod, Shape
from sim.phantom.scan import Scan
from sim.phantom.scanner.grid import place_grid
from sim.world.noise import noise
from sim.world.rigid import as_point
from sim.world.scene.model import Head, Scene
from sim.world.scene.skin import head_with_face

TUBE_MM, BORE_MM, TUBE_HU = 5.5, 3.75, 180.0  # radii of an endotracheal tube, 7.5 mm wide inside
TUBE_LENGTH_MM, TUBE_INSIDE_MM = 90.0, 15.0  # from the lips; behind them
TUBE_BESIDE_MM = 15.0  # in the corner of the mouth
TUBE_ALONG = (0.25, -0.85, -0.45)  # out of the mouth, to the patient's left


@dataclass(frozen=True)
class FaceFamily:
    """Surroundings of a head with a face in the CT: headrest, tube, pins."""

    shows: str
    trough: bool = True
    cushion: bool = False
    tube: bool = False
    ear_folds: tuple[float, float] = (0.0, 0.0)
    pins: int = 0


FACE_FAMILIES = {
    "free": FaceFamily("a head in a trough that touches nothing"),
    "resting": FaceFamily("a cushion under the back of the head", trough=False, cushion=True),
    "folded": FaceFamily(
        "ears folded by the support, the left more than the right",
        trough=False,
        cushion=True,
        ear_folds=(1.0, 0.7),
    ),
    "intubated": FaceFamily("a tube in the corner of the mouth", tube=True),
    "clamped": FaceFamily("pins of a clamp and a tube", tube=True, pins=3),
}
SURFACE_FAMILY = "free"


def face_family(name: str) -> FaceFamily:
    """Return a family by name; raises SIM-001 for an unknown name."""
    if name not in FACE_FAMILIES:
        raise BAD_SCENE(
            f"unknown family {name!r} of heads with a face",
            expected=", ".join(FACE_FAMILIES),
            action=did_you_mean(name, FACE_FAMILIES) or None,
        )
    return FACE_FAMILIES[name]


def face_scan(scene: Scene, name: str, fiducials: str) -> Scan:
    """Return the scan of a head with a face; the ears of its scene are as the CT shows them."""
    family = face_family(name)
    folded = scene.head.face is not None and family.ear_folds != scene.head.face.ear_folds
    if folded and any(family.ear_folds):
        scene = fold_ears(scene, family.ear_folds)
    head = scene.head
    generator = noise(scene.seed, f"face {name}", 0)
    anatomy = draw_anatomy(scene)
    around: tuple[Shape, ...] = cushion(head).shapes if family.cushion else ()
    pins = clamp(head, family.pins, generator)
    tube = _tube(head) if family.tube else ()
    anatomy = replace(
        anatomy,
        headrest=trough(head) if family.trough else (),
        surroundings=(*anatomy.surroundings, *around, *tube, *pins.shapes),
        streaks=anatomy.streaks + pins.streaks,
    )
    truth = {
        "family": name,
        "purpose": "surface",
        "centre_mm": list(head.centre_ct_mm),
        "semi_axes_mm": list(head.semi_axes_mm),
        "face": None if head.face is None else head.face.model_dump(mode="json"),
    }
    return Scan(scene, place_grid(head, scene.ct), anatomy, fiducials, truth)


def fold_ears(scene: Scene, folds: tuple[float, float]) -> Scene:
    """Return the scene with ears folded in the CT that stand off in the theatre."""
    head = scene.head
    assert head.face is not None
    face = head.face.model_copy(update={"ear_folds": folds})
    shift = head.skin_shift.model_copy(update={"ears_unfold": True})
    return scene.model_copy(update={"head": head.model_copy(update={"face": face, "skin_shift": shift})})


def _tube(head: Head) -> tuple[Shape, ...]:
    faced = head_with_face(head)
    assert faced is not None
    marks = faced.landmarks
    along = np.array(TUBE_ALONG) / np.linalg.norm(TUBE_ALONG)
    mouth = np.add(head.centre_ct_mm, (TUBE_BESIDE_MM, marks.face_front_mm, marks.mouth_mm))
    start, outwards = as_point(mouth - TUBE_INSIDE_MM * along), as_point(along)
    length = TUBE_INSIDE_MM + TUBE_LENGTH_MM
    return (
        Rod(TUBE_HU, start, outwards, length, TUBE_MM),
        Rod(AIR_HU, start, outwards, length, BORE_MM),
    )
