"""Kinds of misfit that judged second: pads, hydration, slid tissue, thick slices, a tube, a beard.

They judged once, were then looked at, and are development kinds since (decision 33). Each is the displacement
along the outward normal, in the CT frame, outwards positive. Its rms over front and ears of a head is 0.4 to
0.8 of the drawn `size_mm`, in the mean of many draws. Other parts of the head see more or less of it, by the
physics. Beside it all skin has a weak field, of the drawn length.

All leave the brain where it was in the CT. Estimates of ours are marked (U).
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import expit

from ronna_hw.arrays import Array
from sim.world.head_surface.parametric_head import ParametricHead
from sim.world.head_surface.smooth_field import SmoothField
from studies.surface.conditions import Skin
from studies.surface.first_judged_skins import SOFT_MM, Kind, blend_bodies, field, soft_mm

UNEVEN_MM, UNEVEN = 60.0, 0.35  # length over which an effect varies on the head, and by how much (U)

# Pads of a CT's head holder on both sides, at temples, cheekbones or cheeks: before the ears, and above (U)
PAD_RADII_MM, PAD_EDGE_MM = (18.0, 32.0), 6.0
PAD_BEFORE_MM, PAD_HEIGHTS_MM = (0.0, 45.0), (-30.0, 25.0)
PAD_SIDES = (0.6, 1.4)  # of each side, relative to both
PAD_SHARE = 3.5  # of tissue as thick as the cheek's

# Skin changes by hydration and relaxants (Perwög et al., Int. J. CARS 2018, doi 10.1007/s11548-018-1800-0)
HYDRATION_SHARE = 0.8  # of the cheek

# Tissue that slides along the bone takes its thickness with it. How far each body's slides, relative (U)
MOBILE = {
    "cranium": 1.0,
    "brow": 1.0,
    "nose": 0.2,
    "eye": 0.3,
    "ear": 0.2,
    "cheek": 1.0,
    "jaw": 0.7,
    "neck": 1.0,
}
SLIDE_TURNS = (1.0, 0.4, 0.7)  # about the axes to the left, back and vertex: up and down most (U)
PADDING = 0.15  # variation of the thickness over the drawn length, relative (U)
SLIDE_STEP_MM = 1.0
SLIDE_SHARE = 4.0  # way of the tissue

# The edge of skin in the CT is as wide as a slice is thick, across the slice. A threshold beside its half,
# as -300 HU is, shifts the surface there: outside the shown one in the mean, as air is cut off.
BLUR_RATIOS = (3.0, 8.0)  # width of the edge across the slice, relative to along
LEVEL = (0.6, 0.8)  # mean and standard deviation of the shift across the slice (U)
TILT_DEG = (0.0, 20.0)  # of the slices, along the base of the skull (U)
BLUR_SHARE = 1.1

# A tube that is taped to one corner of the mouth pulls it aside and down; the tape presses the cheek (U)
CORNER_MM, CORNER_BEHIND_MM = 24.0, 9.0  # of the corner from the middle, and behind the lips
PULL, PULL_SPREAD = (1.0, 0.3, -0.7), 0.5  # mean direction: to its side, back, up; standard deviation
PULLED_MM = (18.0, 30.0)  # standard deviation of the region that follows
TAPE_MM, TAPE_LENGTH_MM, TAPE_PRESSURE = 11.0, 35.0, 0.6  # half its width and length
TUBE_SHARE = 5.6

# A beard grows by 0.3 to 0.5 mm a day, as is often stated; it hardly shows in a CT
BEARD_LINE, BEARD_EDGE_MM = (
    0.5,
    4.0,
)  # its upper line at the ears, from the base of the nose to their middle (U)
BEARD_TO_EAR_MM, BEARD_BELOW_MM = 4.0, 15.0  # it ends before the ears, and below the chin
LIPS_MM = (22.0, 7.0)  # half width and height of the lips
TUFT_MM, STRAND_MM = 18.0, 2.0  # over which length and gaps of the hair vary
DEEP_TO_TIPS = 1.7  # slope of the light's depth by the field of the strands: nearly uniform
BEARD_SHARE = 3.1


class Blur(NamedTuple):
    """Thick slices: tilt about the axis to the left, and width of an edge across them relative to along."""

    tilt_deg: float
    ratio: float

    @property
    def across(self) -> Array:
        """Unit vector (3,) across the slices, in the CT frame."""
        turn = Rotation.from_euler("x", self.tilt_deg, degrees=True)
        return np.asarray(turn.apply([0.0, 0.0, 1.0]))

    def voxel_mm(self, edge_mm: float) -> Array:
        """Return the edges (3, 3) of a voxel, as rows, for the width of an edge along the slices."""
        turn = Rotation.from_euler("x", self.tilt_deg, degrees=True)
        return np.asarray(edge_mm * np.diag([1.0, 1.0, self.ratio]) @ turn.as_matrix().T)


def foresee_blur(random: np.random.Generator) -> Blur:
    """Return the thick slices that `displace` will draw: they are stated with the CT, beside its values."""
    ahead = deepcopy(random)
    field(ahead, 1.0)
    return draw_blur(ahead)


def draw_blur(random: np.random.Generator) -> Blur:
    """Draw thick slices; `Skin.BLUR` draws nothing before them but the seed of the weak field beside."""
    return Blur(tilt_deg=random.uniform(*TILT_DEG), ratio=random.uniform(*BLUR_RATIOS))


def _pads(head: ParametricHead, points_mm: Array, length_mm: float, random: np.random.Generator) -> Array:
    """Release soft tissue that pads pressed on both sides in the CT."""
    own, (_, ear_y, ear_z) = points_mm - head.centre_ct_mm, head.landmarks.ear
    middle = ear_y - random.uniform(*PAD_BEFORE_MM), ear_z + random.uniform(*PAD_HEIGHTS_MM)
    radius_mm = random.uniform(*PAD_RADII_MM)
    away = np.hypot(own[:, 1] - middle[0], own[:, 2] - middle[1])
    right, left = abs(random.standard_normal()) * random.uniform(*PAD_SIDES, size=2)
    sideways = np.abs(head.normals(points_mm)[:, 0])
    pressed = np.where(own[:, 0] > 0.0, left, right) * expit((radius_mm - away) / PAD_EDGE_MM) * sideways
    return np.asarray(PAD_SHARE * pressed * _relative_thickness(head, points_mm))


def _hydration(
    head: ParametricHead, points_mm: Array, length_mm: float, random: np.random.Generator
) -> Array:
    """Let soft tissue swell or shrink everywhere, by a part of its thickness."""
    amount = HYDRATION_SHARE * random.standard_normal()
    return np.asarray(amount * _relative_thickness(head, points_mm) * _uneven(points_mm, random))


def _slide(head: ParametricHead, points_mm: Array, length_mm: float, random: np.random.Generator) -> Array:
    """Slide scalp and face along the bone: thick tissue comes to where thin was, and the reverse."""
    padding = field(random, length_mm)
    turn = random.standard_normal(3) * SLIDE_TURNS
    own, normals = points_mm - head.centre_ct_mm, head.normals(points_mm)
    way = np.cross(turn, own) / np.mean(head.semi_axes_mm)
    way -= np.einsum("ni,ni->n", way, normals)[:, None] * normals

    def thickness_mm(points: Array) -> Array:
        return soft_mm(head, points) * (1.0 + PADDING * padding.at(points))

    step = SLIDE_STEP_MM * way
    thicker = (thickness_mm(points_mm - step) - thickness_mm(points_mm + step)) / (2.0 * SLIDE_STEP_MM)
    return np.asarray(SLIDE_SHARE * blend_bodies(MOBILE, head, points_mm) * thicker)


def _blur(head: ParametricHead, points_mm: Array, length_mm: float, random: np.random.Generator) -> Array:
    """Shift the level of the skin where it is along the slices of a CT with thick ones."""
    blur = draw_blur(random)
    along_slice_squared = (head.normals(points_mm) @ blur.across) ** 2
    wider = np.sqrt(1.0 + (blur.ratio**2 - 1.0) * along_slice_squared) - 1.0
    return np.asarray(BLUR_SHARE * random.normal(*LEVEL) * wider / (blur.ratio - 1.0))


def _tube(head: ParametricHead, points_mm: Array, length_mm: float, random: np.random.Generator) -> Array:
    """Pull a corner of the mouth with its cheek, and press the cheek under the tape."""
    marks, side = head.landmarks, float(random.choice((-1.0, 1.0)))
    own = (points_mm - head.centre_ct_mm) * (side, 1.0, 1.0)
    normals = head.normals(points_mm) * (side, 1.0, 1.0)
    from_corner = own - [CORNER_MM, marks.face_front_mm + CORNER_BEHIND_MM, marks.mouth_mm]
    follows = np.exp(-0.5 * np.square(from_corner).sum(axis=1) / random.uniform(*PULLED_MM) ** 2)
    pull = np.array(PULL) + PULL_SPREAD * random.standard_normal(3)
    tape = np.array([1.0, 1.0, random.uniform(-0.3, 0.6)])  # from the corner over the cheek
    tape /= np.linalg.norm(tape)
    along = from_corner @ tape
    beside_squared = np.square(from_corner - along[:, None] * tape).sum(axis=1)
    taped = np.exp(-0.5 * beside_squared / TAPE_MM**2 - 0.5 * (along / TAPE_LENGTH_MM - 1.0) ** 2)
    taped *= expit(4.0 * own[:, 0] / CORNER_MM)
    pulled = abs(random.standard_normal()) * follows * (normals @ pull)
    return np.asarray(TUBE_SHARE * (pulled - TAPE_PRESSURE * abs(random.standard_normal()) * taped))


def _beard(head: ParametricHead, points_mm: Array, length_mm: float, random: np.random.Generator) -> Array:
    """Let a beard grow: light ends between the skin and the tips."""
    own, marks = points_mm - head.centre_ct_mm, head.landmarks
    _, ear_y, ear_z = marks.ear
    back = np.clip((own[:, 1] - marks.face_front_mm) / (ear_y - marks.face_front_mm), 0.0, 1.0)
    line = marks.nose_base_mm + BEARD_LINE * back * (ear_z - marks.nose_base_mm)
    below = expit((line - own[:, 2]) / BEARD_EDGE_MM - 1.0)
    above_end = expit((own[:, 2] - marks.menton_mm + BEARD_BELOW_MM) / BEARD_EDGE_MM)
    before_ears = expit((ear_y - BEARD_TO_EAR_MM - own[:, 1]) / BEARD_EDGE_MM)
    from_mouth = np.hypot(own[:, 0] / LIPS_MM[0], (own[:, 2] - marks.mouth_mm) / LIPS_MM[1])
    beside_lips = expit(LIPS_MM[1] * (from_mouth - 1.0))
    tufts = np.maximum(1.0 + UNEVEN * field(random, TUFT_MM).at(points_mm), 0.0)
    strands = SmoothField(int(random.integers(2**31)), "beard strands", STRAND_MM, 0.5).at(points_mm)
    length = BEARD_SHARE * abs(random.standard_normal()) * tufts * expit(DEEP_TO_TIPS * strands)
    return np.asarray(length * below * above_end * before_ears * beside_lips)


def _relative_thickness(head: ParametricHead, points_mm: Array) -> Array:
    """Return the thickness of the soft tissue relative to the cheek's."""
    return np.asarray(soft_mm(head, points_mm) / SOFT_MM["cheek"])


def _uneven(points_mm: Array, random: np.random.Generator) -> Array:
    return np.asarray(1.0 + UNEVEN * field(random, UNEVEN_MM).at(points_mm))


SECOND_JUDGED_KINDS: Mapping[Skin, Kind] = {
    Skin.PADS: _pads,
    Skin.HYDRATION: _hydration,
    Skin.SLIDE: _slide,
    Skin.BLUR: _blur,
    Skin.TUBE: _tube,
    Skin.BEARD: _beard,
}
