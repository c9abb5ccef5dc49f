"""Kinds of misfit that judge: clenched teeth, a mask's marks, bruises, hair in the CT, stairs, rounding.

They were written without sight of the estimator or its results by kind (decision 33); nothing may be tuned
on them. Each is the displacement along the outward normal, in the CT frame, outwards positive. Its rms over
front and ears of a head is 0.35 to 0.8 of the drawn `size_mm`, in the mean of many draws. Other parts of the
head see more or less of it, by the physics. Beside it all skin has a weak field, of the drawn length.

All leave the brain where it was in the CT. Estimates of ours are marked (U).
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import expit

from ronna_hw.arrays import Array
from sim.world.head_surface.parametric_head import ParametricHead
from sim.world.head_surface.regions import above_hair_line_mm
from studies.surface.conditions import Skin
from studies.surface.first_judged_skins import SOFT_MM, Kind, field, soft_mm

PROJECTIONS = 4  # steps from a place near the skin onto it

# Clenched, the masseter is 15.1 mm thick in men and 13.0 in women; relaxed, 9.7 and 8.7 (40 adults;
# Kiliaridis and Kälebo, J. Dent. Res. 70:1262, 1991). Relaxants thin it; some clench in the theatre only (U).
CLENCHED = (-0.5, 0.6)  # mean and standard deviation of the change since the CT (U)
# Bellies: standard deviations along and across, turn of the upper end to the back (U)
MASSETER_MM, MASSETER_TURN_DEG = (20.0, 12.0), -20.0
TEMPORALIS_MM, TEMPORALIS_TURN_DEG = (25.0, 21.0), 25.0
MASSETER_FROM_EAR_MM, TEMPORALIS_FROM_EAR_MM = (-30.0, -38.0), (-32.0, 44.0)  # back and up
TEMPORALIS_SHARE, CHEWING_SIDE = 0.55, (0.6, 1.4)  # relative to the masseter, and of each side (U)
TENDON = 0.35  # a short belly is thick in its middle and hollow at its ends, relative (U)
CHIN_MM, CHIN_SHARE = (16.0, 11.0), 0.5  # mentalis: half width and height, and its change (U)
CLENCH_SHARE = 4.5

# A mask pressed the bridge of the nose with 66 mmHg and the cheeks with 15 (12 persons; Anaesthesia 62:1126,
# 2007, doi 10.1111/j.1365-2044.2007.05190.x). Its seam leaves a groove with swollen edges, the straps a
# shallow one; both fade within the hour (U).
SEAM_MM, SEAM_BULGE = (3.0, 6.0), 0.45  # standard deviation across, and what bulges beside
MASK_TOP_MM, MASK_BELOW_MM = (-22.0, -4.0), (4.0, 16.0)  # below the nose's root, and below the mouth
MASK_HALF_MM, NARROW = (32.0, 42.0), 0.55  # half width; the seam's at the nose, relative to the mouth's
MASK_ASIDE_MM, BRIDGE = 3.0, 1.4  # how far it sits aside; more pressure where the skin is thin
STRAP_MM, STRAP_SHARE = (6.0, 10.0), 0.6  # half width, and depth relative to the seam
STRAPS_AT_EAR_MM = (42.0, -28.0)  # heights above the ear's middle at which both straps pass it
MASK_EDGE_MM, FLAT_PRESSURE = 6.0, 0.35  # seams end behind the cheek; variation over its length
PRESSURE_MM = 30.0
WORN, MASK_SHARE = (0.2, 1.8), 2.3  # how much of a mark is left, uniform

# After a fall: a bruise grows soft and sinks in its middle while its rim stays firm; blood tracks down (U).
BRUISES, BRUISE_AZIMUTH_DEG, BRUISE_ELEVATION_DEG = (1, 4), (-100.0, 100.0), (-25.0, 60.0)
BRUISE_RADII_MM, FLATNESS, RIM_MM = (14.0, 32.0), (0.7, 1.4), (3.5, 6.0)  # one axis against the other
CORE, RIM = 1.0, (0.7, 0.5)  # standard deviation in the middle; mean and standard deviation of the rim (U)
RIM_ROUND_MM, RIM_UNEVEN = 14.0, 0.4  # length over which it varies, and by how much
TRACK, TRACK_RADII = 0.6, (0.8, 1.6)  # of the blood below; its half width and length, relative
BRUISE_SHARE = 1.5

# Braids and matted hair are dense enough to be taken for skin by a threshold in air; the theatre scans the
# shaved or parted skin below (U). So all shifts are inwards, end at the hair line, and the parting has none.
MAT_EDGE_MM, MAT_MM, MAT_UNEVEN = 3.0, 22.0, 0.45  # of the hair line; length and size of its variation
PARTING_MM, PARTED_ASIDE_MM = (3.0, 7.0), 35.0  # half width, and how far from the middle
PARTING_END = (-0.2, 0.4)  # share of the cranium's half length, to the back
KNOT_MM, KNOT_SHARE = (18.0, 30.0), 1.4  # of a plait or knot, on the vault or behind
KNOT_AZIMUTH_DEG, KNOT_ELEVATION_DEG = (60.0, 300.0), (10.0, 80.0)
DENSE = (0.3, 1.3)  # of the mat, uniform
MAT_SHARE = 0.9

# Surfaces that are inclined to the slices show stairs, in proportion to the table's way between slices,
# larger off the middle (Fleischmann et al., Radiology 216:185, 2000). In a helical CT they wind around (U).
STEP_MM, STEP_MEAN_MM, STEP_TILT_DEG = (2.0, 5.0), 3.5, (0.0, 20.0)
HELICAL_SHARE, SAW = 0.5, 0.75  # of the CTs; how near a step is to a saw's tooth
OFF_MIDDLE_MM, OFF_MIDDLE = 100.0, 0.8  # twice as large there, nearly
INTERPOLATION = 0.35  # of a step that is left after the interpolation between slices, at least (U)
STAIR_SHARE = 2.9

# A surface that is smoothed, in grey values or as a mesh, loses its crests and fills its hollows; a kernel
# that sharpens does the reverse. Over a sphere the mean distance to the skin says by how much.
SMOOTHED_MM, SMOOTHED_MEAN_MM, SHARPENED = (3.0, 7.0), 5.0, (0.9, 0.5)
MOST_ROUNDED = 3.0  # no thin part moves much further
ROUND_SHARE = 1.6


def _clenched(head: ParametricHead, points_mm: Array, length_mm: float, random: np.random.Generator) -> Array:
    """Relax or tighten the muscles of the jaw: masseter, temporalis and mentalis."""
    own, marks = points_mm - head.centre_ct_mm, head.landmarks
    normals = head.normals(points_mm)
    sideways, on_left = np.abs(normals[:, 0]), own[:, 0] > 0.0
    ear_y, ear_z = marks.ear[1:]
    bellies = np.zeros(len(points_mm))
    for (along_mm, across_mm), turn_deg, (back, up), share in (
        (MASSETER_MM, MASSETER_TURN_DEG, MASSETER_FROM_EAR_MM, 1.0),
        (TEMPORALIS_MM, TEMPORALIS_TURN_DEG, TEMPORALIS_FROM_EAR_MM, TEMPORALIS_SHARE),
    ):
        sine, cosine = np.sin(np.radians(turn_deg)), np.cos(np.radians(turn_deg))
        y, z = own[:, 1] - ear_y - back, own[:, 2] - ear_z - up
        along, across = (cosine * z + sine * y) / along_mm, (cosine * y - sine * z) / across_mm
        left, right = random.uniform(*CHEWING_SIDE, size=2)
        belly = (1.0 - TENDON * along**2) * np.exp(-0.5 * (along**2 + across**2))
        bellies += share * np.where(on_left, left, right) * belly * sideways**2
    half_mm, high_mm = CHIN_MM
    chin_z = 0.5 * (marks.mouth_mm + marks.menton_mm)
    chin = np.exp(-0.5 * ((own[:, 0] / half_mm) ** 2 + ((own[:, 2] - chin_z) / high_mm) ** 2))
    chin *= CHIN_SHARE * np.maximum(-normals[:, 1], 0.0)
    return np.asarray(CLENCH_SHARE * random.normal(*CLENCHED) * (bellies + random.uniform() * chin))


def _mask(head: ParametricHead, points_mm: Array, length_mm: float, random: np.random.Generator) -> Array:
    """Press the seam of a mask around nose and mouth into the skin, and its straps."""
    own, marks = points_mm - head.centre_ct_mm, head.landmarks
    x, y, z = own.T
    top = marks.sellion_mm + random.uniform(*MASK_TOP_MM)
    bottom = marks.mouth_mm - random.uniform(*MASK_BELOW_MM)
    middle, half_high = 0.5 * (top + bottom), 0.5 * (top - bottom)
    height = (z - middle) / half_high
    # A pear: wide at the mouth, narrow on the nose
    half_wide = random.uniform(*MASK_HALF_MM) * (1.0 - (1.0 - NARROW) * expit(3.0 * height))
    aside = x - MASK_ASIDE_MM * random.standard_normal()
    out = np.hypot(aside / half_wide, height)
    # Distance to the outline: what is beyond it, by its steepness
    slope = np.hypot(aside / half_wide**2, height / half_high) / np.maximum(out, 0.1)
    seam_mm = random.uniform(*SEAM_MM)
    away = (out - 1.0) / slope / seam_mm
    ear_y, ear_z = marks.ear[1:]
    in_front = expit((0.5 * (marks.face_front_mm + ear_y) - y) / MASK_EDGE_MM)
    seam = (1.0 - SEAM_BULGE * away**2) * np.exp(-0.5 * away**2) * in_front
    thin = 1.0 - soft_mm(head, points_mm) / SOFT_MM["cheek"]
    seam *= 1.0 + (BRIDGE - 1.0) * np.clip(thin, 0.0, 1.0)
    outside = expit(away - 1.0)
    back = np.clip((y - marks.face_front_mm) / (ear_y - marks.face_front_mm), 0.0, 1.0)
    straps = np.zeros(len(points_mm))
    for start, at_ear in zip((0.5, -0.5), STRAPS_AT_EAR_MM, strict=True):
        line = middle + start * half_high + back * (ear_z + at_ear - middle - start * half_high)
        straps += np.exp(-(((z - line) / random.uniform(*STRAP_MM)) ** 4))
    pressure = np.maximum(1.0 + FLAT_PRESSURE * field(random, PRESSURE_MM).at(points_mm), 0.0)
    pressed = seam + STRAP_SHARE * random.uniform() * outside * straps
    return np.asarray(-MASK_SHARE * random.uniform(*WORN) * pressure * pressed)


def _bruise(head: ParametricHead, points_mm: Array, length_mm: float, random: np.random.Generator) -> Array:
    """Raise bruises, or let them sink within their firm rims."""
    own, normals = points_mm - head.centre_ct_mm, head.normals(points_mm)
    uneven = field(random, RIM_ROUND_MM).at(points_mm)
    bruised = np.zeros(len(points_mm))
    for _ in range(int(random.integers(*BRUISES))):
        place = _direction(random.uniform(*BRUISE_AZIMUTH_DEG), random.uniform(*BRUISE_ELEVATION_DEG))
        centre, normal = _on_skin(head, place)
        across = np.cross(normal, [0.0, 0.0, 1.0])
        across /= np.linalg.norm(across)
        from_centre = own - centre
        sideways, upwards = from_centre @ across, from_centre @ np.cross(across, normal)
        radius_mm, flatness = random.uniform(*BRUISE_RADII_MM), np.sqrt(random.uniform(*FLATNESS))
        deep = from_centre @ normal / radius_mm  # other sides of the head are far from it
        away_mm = np.linalg.norm([sideways * flatness, upwards / flatness, radius_mm * deep], axis=0)
        rim_mm = random.uniform(*RIM_MM)
        core = CORE * random.standard_normal() * expit((radius_mm - away_mm) / (0.5 * rim_mm))
        rim = random.normal(*RIM) * np.exp(-0.5 * ((away_mm - radius_mm) / rim_mm) ** 2)
        half_wide, half_long = radius_mm * np.array(TRACK_RADII)
        below = (sideways / half_wide) ** 2 + (upwards / half_long + 1.0) ** 2 + deep**2
        track = TRACK * random.uniform() * np.exp(-0.5 * below)
        facing = expit(8.0 * (normals @ normal))
        bruised += facing * (core + (1.0 + RIM_UNEVEN * uneven) * rim + track)
    return np.asarray(BRUISE_SHARE * bruised)


def _matted(head: ParametricHead, points_mm: Array, length_mm: float, random: np.random.Generator) -> Array:
    """Take matted hair of the CT for skin, but for its parting."""
    own, normals = points_mm - head.centre_ct_mm, head.normals(points_mm)
    grown = expit(above_hair_line_mm(head, points_mm) / MAT_EDGE_MM)
    ear_distance = head.parts(*np.ascontiguousarray(points_mm.T)).ear.value
    grown *= expit((ear_distance - MAT_EDGE_MM) / (0.5 * MAT_EDGE_MM))
    beside = (own[:, 0] - PARTED_ASIDE_MM * random.uniform(-1.0, 1.0)) / random.uniform(*PARTING_MM)
    parted = np.exp(-0.5 * beside**2) * expit(8.0 * normals[:, 2])
    end_mm = random.uniform(*PARTING_END) * head.semi_axes_mm[1]
    parted *= expit((end_mm - own[:, 1]) / MAT_EDGE_MM)
    knot, _ = _on_skin(
        head, _direction(random.uniform(*KNOT_AZIMUTH_DEG), random.uniform(*KNOT_ELEVATION_DEG))
    )
    from_knot = np.linalg.norm(own - knot, axis=1) / random.uniform(*KNOT_MM)
    tufts = np.maximum(1.0 + MAT_UNEVEN * field(random, MAT_MM).at(points_mm), 0.0)
    mat = random.uniform(*DENSE) * tufts + KNOT_SHARE * random.uniform() * np.exp(-0.5 * from_knot**2)
    return np.asarray(-MAT_SHARE * grown * (1.0 - parted) * mat)


def _stairs(head: ParametricHead, points_mm: Array, length_mm: float, random: np.random.Generator) -> Array:
    """Shift the level of inclined skin up and down with the steps between slices."""
    turn = Rotation.from_euler("x", random.uniform(*STEP_TILT_DEG), degrees=True)
    x, y, z = turn.inv().apply(points_mm - head.centre_ct_mm).T
    slope = np.abs(turn.inv().apply(head.normals(points_mm))[:, 2])
    step_mm = random.uniform(*STEP_MM)
    winding = float(random.choice((-1.0, 1.0))) * float(random.uniform() < HELICAL_SHARE)
    phase = 2.0 * np.pi * (z / step_mm + random.uniform()) + winding * np.arctan2(y, x)
    tooth = 2.0 * np.arctan2(SAW * np.sin(phase), 1.0 - SAW * np.cos(phase)) / np.pi
    larger = 1.0 + OFF_MIDDLE * np.hypot(x, y) / OFF_MIDDLE_MM
    left = random.uniform(INTERPOLATION, 1.0) * step_mm / STEP_MEAN_MM
    return np.asarray(STAIR_SHARE * left * larger * slope * tooth)


def _rounded(head: ParametricHead, points_mm: Array, length_mm: float, random: np.random.Generator) -> Array:
    """Uncover crests that a smoothed CT has lost, and hollows that it has filled."""
    smoothed_mm = random.uniform(*SMOOTHED_MM)
    rays = np.array([ray for ray in product((-1.0, 0.0, 1.0), repeat=3) if any(ray)])
    # To the faces, edges and corners of a cube, weighed for a mean over the sphere (Lebedev's 26 points)
    share = np.array([40.0, 32.0, 27.0])[np.count_nonzero(rays, axis=1) - 1] / 840.0
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    places = points_mm + smoothed_mm * rays[:, None]
    lost_mm = share @ head.distance_mm(places.reshape(-1, 3)).reshape(len(rays), -1)
    relative = (lost_mm - head.distance_mm(points_mm)) * (SMOOTHED_MEAN_MM / smoothed_mm)
    amount = ROUND_SHARE * random.normal(*SHARPENED)
    return np.asarray(amount * MOST_ROUNDED * np.tanh(relative / MOST_ROUNDED))


def _direction(azimuth_deg: float, elevation_deg: float) -> Array:
    """Return the unit direction (3,) of an angle from the front to the left and one upwards."""
    azimuth, elevation = np.radians((azimuth_deg, elevation_deg))
    level = np.cos(elevation)
    return np.array([level * np.sin(azimuth), -level * np.cos(azimuth), np.sin(elevation)])


def _on_skin(head: ParametricHead, direction: Array) -> tuple[Array, Array]:
    """Return the place (3,) of the skin near a direction of the cranium, from its centre, and its normal."""
    place = (direction / np.linalg.norm(direction / np.asarray(head.semi_axes_mm)) + head.centre_ct_mm)[None]
    for _ in range(PROJECTIONS):
        place = place - head.distance_mm(place)[:, None] * head.normals(place)
    return place[0] - head.centre_ct_mm, head.normals(place)[0]


JUDGED_KINDS: Mapping[Skin, Kind] = {
    Skin.CLENCHED: _clenched,
    Skin.MASK: _mask,
    Skin.BRUISE: _bruise,
    Skin.MATTED: _matted,
    Skin.STAIRS: _stairs,
    Skin.ROUNDED: _rounded,
}
