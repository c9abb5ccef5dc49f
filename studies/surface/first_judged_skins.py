"""Kinds of misfit that judged first: what gravity, fluid, straps, relaxed muscles and the CT do to the skin.

They judged once, were then looked at, and are development kinds since (decision 33). Each is the displacement
along the outward normal, in the CT frame, outwards positive. Its rms over front and ears of a head is 0.35 to
0.8 of the drawn `size_mm`, in the mean of many draws, like that of the events among the other development
skins. Other parts of the head see more or less of it, by the physics. Beside it all skin has a weak field, of
the drawn length.

Truth is the pose of the brain. A CT of wrong scale, or of a patient who moved, also shows targets at wrong
places; that error is the CT's and not counted here. Estimates of ours are marked (U).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import expit

from ronna_hw.arrays import Array
from sim.world.head_surface.parametric_head import ParametricHead
from sim.world.head_surface.regions import above_hair_line_mm
from sim.world.head_surface.smooth_field import SmoothField
from studies.surface.conditions import Draw, Skin

BESIDE_MM, SMOOTH = 0.05, 2.5  # weak field beside: its standard deviation (U), and the order of smooth fields

# Soft tissue over the bone by body of the head: in the middle 3 mm at the bridge of the nose to 16 mm below
# (222 adults, Forensic Sci. Int. 2018, doi 10.1016/j.forsciint.2018.10.021); cheeks and forehead (U)
SOFT_MM = {
    "cranium": 5.0,
    "brow": 5.0,
    "nose": 4.0,
    "eye": 4.0,
    "ear": 3.0,
    "cheek": 15.0,
    "jaw": 11.0,
    "neck": 15.0,
}
BLEND_MM = 6.0  # over which the thickness of one body goes over into another's (U)
# A layer under its own weight moves by the square of its thickness. Between sitting and supine 1.2 mL move in
# the cheek, about 1 mm over its area (53 persons; Ramesh et al., Aesthetic Surg. J. 2020).
TURN_DEG, FLEXION_DEG = 75.0, (-20.0, 45.0)  # of the head on the table against that in the CT (U)
SAG_SHARE = 2.7  # of the cheek, relative to the drawn size

# Fluid gathers in lax skin; lids most, then lips, then the cheek of the lower side (U)
LIDS_SHARE, LIPS_SHARE, CHEEK_SHARE = 2.7, 2.2, 2.2
LIDS_MM, LIPS_MM, CHEEK_MM, SWOLLEN_EDGE_MM = 6.0, 22.0, 1.5, 3.0  # reach of each, and the edge
OTHER_SIDE = (0.0, 0.8)  # swelling of the other side's lids, relative
MIDDLE_MM = 12.0  # over which one side goes over into the other

# 4 of 10 acute patients move in the CT, most by nodding (80 persons; Eur. J. Radiol. 144:109979, 2021)
MOVES, SLICE_EDGE_MM = (1, 4), 3.0  # movements in a scan, and the height over which the slices blend
NOD_RAD_PER_MM = 1.0 / 80.0  # nodding that moves the skin as far as a displacement does
OTHER_TURN = 0.3  # turns about the other axes, relative to nodding (U)
BRAIN = (-0.3, 1.0)  # lowest and highest part of the brain, relative to the cranium's height
MOVE_SHARE = 0.95

# Tables are within 1 mm over their way and gantries within 1 degree (AAPM TG-66, quoted without the text at
# hand): over 300 mm 0.3 % of scale; the shear is drawn as small, far below what is permitted
STRAIN_PER_MM = 0.005  # of scale and shear for each millimetre of the drawn size

# Straps are 25 to 50 mm wide with soft edges (U)
BAND_MM = (8.0, 18.0)  # standard deviation across the pressed band
BAND_HEIGHTS_MM, BAND_TILT = (-30.0, 45.0), 0.3  # of its plane above the head's centre; standard deviation
BULGE = 0.5  # share of the pressed tissue that bulges beside
TENSION_MM, TENSION = 60.0, 0.35  # length over which the pressure varies, and by how much (U)
BAND_SHARE = 2.2

# Folds across forehead and face follow the muscles, which relax under anaesthesia: long along, short across
ALONG, ACROSS = 2.5, 0.4  # relative to the drawn length (U)
AT_REST = 0.25  # folds where no muscle moves the skin, relative (U)
FACE_FROM, FACE_EDGE = -0.3, 0.1  # front of the head, relative to the cranium's half length
HAIR_EDGE_MM = 8.0


Kind = Callable[[ParametricHead, Array, float, np.random.Generator], Array]


def displace_beside(
    kind: Kind, head: ParametricHead, points_mm: Array, draw: Draw, random: np.random.Generator
) -> Array:
    """Return the displacement (n,) of a kind beside the weak field: no skin is still otherwise."""
    beside = field(random, draw.length_mm).at(points_mm)
    return np.asarray(BESIDE_MM * beside + draw.size_mm * kind(head, points_mm, draw.length_mm, random))


def _sag(head: ParametricHead, points_mm: Array, length_mm: float, random: np.random.Generator) -> Array:
    """Let soft tissue follow gravity, whose direction changes as the head is turned."""
    angles_deg = random.uniform(-TURN_DEG, TURN_DEG), random.uniform(*FLEXION_DEG)
    down = np.array([0.0, 1.0, 0.0])  # in the CT: to the back
    change = Rotation.from_euler("zx", angles_deg, degrees=True).apply(down) - down
    change /= np.linalg.norm(change)
    softness = (soft_mm(head, points_mm) / SOFT_MM["cheek"]) ** 2
    return np.asarray(SAG_SHARE * softness * (head.normals(points_mm) @ change))


def _oedema(head: ParametricHead, points_mm: Array, length_mm: float, random: np.random.Generator) -> Array:
    """Let fluid gather in lids, lips and the cheek of one side."""
    own = points_mm - head.centre_ct_mm
    parts, marks = head.parts(*np.ascontiguousarray(points_mm.T)), head.landmarks
    on_side = expit(4.0 * float(random.choice((-1.0, 1.0))) * own[:, 0] / MIDDLE_MM)
    lids = expit((LIDS_MM - parts.eye.value) / SWOLLEN_EDGE_MM)
    from_mouth = np.linalg.norm(own - [0.0, marks.face_front_mm, marks.mouth_mm], axis=1)
    lips = expit((LIPS_MM - from_mouth) / SWOLLEN_EDGE_MM)
    cheek = on_side * expit((CHEEK_MM - parts.cheek.value) / SWOLLEN_EDGE_MM)
    lids *= on_side + float(random.uniform(*OTHER_SIDE)) * (1.0 - on_side)
    amounts = np.abs(random.standard_normal(3)) * (LIDS_SHARE, LIPS_SHARE, CHEEK_SHARE)
    return np.asarray(amounts @ np.array([lids, lips, cheek]))


def _slices(head: ParametricHead, points_mm: Array, length_mm: float, random: np.random.Generator) -> Array:
    """Move the skin above a slice against that below, as by a patient who moved during the CT."""
    own = points_mm - head.centre_ct_mm
    lowest, highest = head.landmarks.menton_mm, head.semi_axes_mm[2]
    brain = highest * np.linspace(*BRAIN)
    moved = np.zeros_like(own)
    for _ in range(int(random.integers(*MOVES))):
        height = random.uniform(lowest, highest)
        shift = random.standard_normal(3)
        turn = NOD_RAD_PER_MM * random.standard_normal(3) * (1.0, OTHER_TURN, OTHER_TURN)
        above, brain_above = (
            expit(4.0 * (heights - height) / SLICE_EDGE_MM) for heights in (own[:, 2], brain)
        )
        moved += (above - brain_above.mean())[:, None] * (shift + np.cross(turn, own))
    return np.asarray(MOVE_SHARE * np.einsum("ni,ni->n", moved, head.normals(points_mm)))


def _scale(head: ParametricHead, points_mm: Array, length_mm: float, random: np.random.Generator) -> Array:
    """Strain the head by a CT of wrong scale, in the slice and along the table, and a tilted gantry.

    The turn that is part of a shear is left out, as it is no misfit.
    """
    in_slice, along, shear = STRAIN_PER_MM * random.standard_normal(3)
    strain = np.diag([in_slice, in_slice, along])
    strain[1, 2] = strain[2, 1] = 0.5 * shear
    moved = (points_mm - head.centre_ct_mm) @ strain
    return np.asarray(np.einsum("ni,ni->n", moved, head.normals(points_mm)))


def _band(head: ParametricHead, points_mm: Array, length_mm: float, random: np.random.Generator) -> Array:
    """Press a band around the head by a strap in the CT or in the theatre; tissue bulges beside it."""
    axis = np.append(BAND_TILT * random.standard_normal(2), 1.0)
    height, width = random.uniform(*BAND_HEIGHTS_MM), random.uniform(*BAND_MM)
    away = ((points_mm - head.centre_ct_mm) @ axis / np.linalg.norm(axis) - height) / width
    pressed = (1.0 - BULGE * away**2) * np.exp(-0.5 * away**2)
    pressure = 1.0 + TENSION * field(random, TENSION_MM).at(points_mm)
    return np.asarray(BAND_SHARE * float(random.choice((-1.0, 1.0))) * pressed * pressure)


def _folds(head: ParametricHead, points_mm: Array, length_mm: float, random: np.random.Generator) -> Array:
    """Flatten or deepen folds of forehead and face, as muscles relax and skin is stretched."""
    own = points_mm - head.centre_ct_mm
    lengths_mm = length_mm * np.array([ALONG, ALONG, ACROSS])
    folds = field(random, 1.0).at(own / lengths_mm)
    front = expit((FACE_FROM - own[:, 1] / head.semi_axes_mm[1]) / FACE_EDGE)
    mobile = front * expit(-above_hair_line_mm(head, points_mm) / HAIR_EDGE_MM)
    return np.asarray((AT_REST + (1.0 - AT_REST) * mobile) * folds)


def soft_mm(head: ParametricHead, points_mm: Array) -> Array:
    """Return the thickness (n,) of the soft tissue at points (n, 3) of the skin."""
    return blend_bodies(SOFT_MM, head, points_mm)


def blend_bodies(values: Mapping[str, float], head: ParametricHead, points_mm: Array) -> Array:
    """Return a value (n,) at points (n, 3) of the skin from one for each body of the head."""
    parts = head.parts(*np.ascontiguousarray(points_mm.T))._asdict()
    near = np.array([np.exp(-parts[body].value / BLEND_MM) for body in values])
    return np.asarray(np.array(list(values.values())) @ near / near.sum(axis=0))


def field(random: np.random.Generator, length_mm: float) -> SmoothField:
    """Draw a smooth field of standard deviation 1."""
    return SmoothField(int(random.integers(2**31)), "judged skin", length_mm, SMOOTH)


FIRST_JUDGED_KINDS: Mapping[Skin, Kind] = {
    Skin.SAG: _sag,
    Skin.OEDEMA: _oedema,
    Skin.SLICES: _slices,
    Skin.SCALE: _scale,
    Skin.BAND: _band,
    Skin.FOLDS: _folds,
}
