"""Kinds of misfit that judged third: wheals, steroids, fluid under the scalp, film, streaks, bent ears.

They judged once, were then looked at, and are development kinds since (decision 33). Each is the displacement
along the outward normal, in the CT frame, outwards positive. Its rms over front and ears of a head is 0.4 to
0.8 of the drawn `size_mm`, in the mean of many draws. Other parts of the head see more or less of it, by the
physics. Beside it all skin has a weak field, of the drawn length.

All leave the brain where it was in the CT. Estimates of ours are marked (U).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import expit

from ronna_hw.arrays import Array
from sim.world.head_surface.parametric_head import BROW_ABOVE_SELLION_MM, ParametricHead
from sim.world.head_surface.skin_shift import PINS
from studies.surface.conditions import Skin
from studies.surface.first_judged_skins import MIDDLE_MM, Kind, blend_bodies, field, soft_mm

PROJECTIONS = 4  # steps from a place near the skin onto it

# Local anaesthetic before clamp and incision: 1 to 3 mL at each nerve of the scalp where a block is given
# (as stated in guides to it), else at pins and entries alone. A part has spread when it is scanned (U).
BLOCKED_SHARE, INJECTED_ML = 0.5, (1.0, 3.0)
WHEALS_MM, LEFT_SHARE = (16.0, 24.0), (0.2, 1.0)  # radii that 1 mL lifts; share that has not spread (U)
ENTRIES, ENTRY_AZIMUTH_DEG, ENTRY_ELEVATION_DEG = (1, 4), (-60.0, 60.0), (25.0, 75.0)
MM3_PER_ML = 1000.0
# Nerves of the left side, outwards, back and up: from the eye the supraorbital, supratrochlear and
# zygomaticotemporal, from the ear's front edge the auriculotemporal and lesser occipital, from the middle of
# the back at the ear's height the greater occipital (U)
FROM_EYE_MM = ((-6.0, -27.0, 20.0), (-16.0, -27.0, 16.0), (24.0, 4.0, 2.0))
FROM_EAR_MM = ((0.0, -12.0, 6.0), (-10.0, 32.0, -14.0))
FROM_BACK_MM = ((30.0, -12.0, -8.0),)
WHEAL_SHARE = 1.1  # of its physical height, at a drawn size of 1 mm

# Dexamethasone over weeks rounds the face (38 of 100 in half a year: Tsutsumi et al., J. Endocr. Soc. 2024,
# doi 10.1210/jendso/bvae036) and thins the temporal muscle; some lose weight instead. By body, relative (U)
FAT = {
    "cranium": 0.08,
    "brow": 0.15,
    "nose": 0.1,
    "eye": 0.3,
    "ear": 0.0,
    "cheek": 1.0,
    "jaw": 0.9,
    "neck": 0.8,
}
FULLER = (0.6, 0.8)  # mean and standard deviation: more often fuller than leaner (U)
IN_FRONT = 0.4  # fat on the front of the face, relative to its sides (U)
TEMPLE_MM, TEMPLE_ABOVE_SELLION_MM, TEMPLE_SHARE = (22.0, 20.0), 12.0, 1.0  # reach along and up (U)
SIDES, UNEVEN_MM, UNEVEN = (0.75, 1.25), 50.0, 0.25  # of each side, and over which length it varies (U)
STEROID_SHARE = 1.15

# Blood or liquor between galea and skull spreads from the brows to the nuchal line and to the temporal fascia
# (Eurorad case 18351, 2023); layers of 7 to 10 mm are published. It grows or is resorbed between CT and
# theatre, and sinks. The border of the galea by the angle from the front: brows, above the ears, nape (U).
GALEA_DEG, GALEA_EDGE_MM = (0.0, 40.0, 90.0, 180.0), 4.0
OVER_EAR_MM, OVER_NUCHA_MM = 25.0, -8.0  # above the middle of the ear, as is the nuchal line
ON_SKULL = {
    "cranium": 1.0,
    "brow": 0.7,
    "nose": 0.0,
    "eye": 0.0,
    "ear": 0.0,
    "cheek": 0.0,
    "jaw": 0.0,
    "neck": 0.0,
}
FLUID_AZIMUTH_DEG, FLUID_ELEVATION_DEG = (-140.0, 140.0), (15.0, 75.0)
FLUID_RADII_MM, FLUID_EDGES_MM = (35.0, 70.0), (4.0, 10.0)
WAVY_MM, WAVE_MM = 35.0, 10.0  # length and size of the waves of its border
SINKING, SUPINE_SHARE = 0.5, 0.5  # more of it at the lower end, which is the back or the brow
FLUID_SHARE = 1.9

# Film is pulled taut over the field, bridges hollows and throws wrinkles (U). Layers of adhesive of 0.05 to
# 1 mm were compared by Namiki et al., ANZ J. Surg. 2020, doi 10.1111/ans.15754
FILM_AZIMUTH_DEG, FILM_ELEVATION_DEG = (-60.0, 60.0), (15.0, 60.0)
FILM_RADII_MM, FILM_EDGE_MM = (75.0, 130.0), 2.0
FILM_ENDS_MM = (-30.0, 15.0)  # its lower edge above the root of the nose: from the nose's tip to the brows
FILM_MM = (0.1, 0.4)  # of film and adhesive
BRIDGED_MM, SLACK, TENT_MM = (8.0, 18.0), 0.3, 3.0  # half span; tangent that still spans; highest tent
CREASE_LENGTHS_MM, CREST = (60.0, 12.0, 12.0), 0.15  # along and across; half width, relative to the field
CREASED_MM, CREASE_MM = 30.0, (0.2, 1.0)  # length over which creases come and go, and their height
FILM_SHARE = 1.9  # of its physical height, at a drawn size of 1 mm

# Metal of teeth throws streaks over its slices, most towards cheeks and tongue (Nabha et al., Korean J.
# Orthod. 2014, doi 10.4041/kjod.2014.44.5.229); plates of a former craniotomy, of titanium, do less (U)
FILLINGS, ARCH_MM, TEETH_BEHIND_MM, CROWN_SD_MM = (2, 9), (27.0, 40.0), 9.0, 7.0  # half width, and depth
PLATED_SHARE, PLATES, PLATE_CIRCLE_MM, FILLING, TITANIUM = 0.4, 4, 28.0, 2.0, 1.0
PLATE_AZIMUTH_DEG, PLATE_ELEVATION_DEG = (-120.0, 120.0), (15.0, 65.0)
STREAKS_MM, RAYS = (3.0, 6.0), (8, 36)  # standard deviation across the slices; streaks around the metal
NEAR_MM, GANTRY_DEG = 20.0, (-10.0, 20.0)  # within which they hardly fade; tilt of the slices
STREAK_SIZES, STREAK_LIMIT = (0.6, 1.4), 1.5  # no edge shifts much further than it is wide
STREAK_SHARE = 1.7

# In half of the patients the head support of the CT had bent the ears (10 patients; Marmulla et al., Minim.
# Invasive Neurosurg. 48:181, 2005). They turn about their front edge, the upper half more (U).
EARS_ALIKE = 0.5  # correlation of both sides
EAR_REACH_MM, EAR_EDGE_MM = 1.5, 0.6  # skin within this of the ear's body follows it
UPPER_HALF, TOP_OUT = 0.5, 0.4  # more bending above the middle; bending of the top alone, relative
EAR_SHARE = 3.7


def _wheals(head: ParametricHead, points_mm: Array, length_mm: float, random: np.random.Generator) -> Array:
    """Lift the skin by what was injected: at nerves, pins and entries."""
    places = _nerves(head) if random.uniform() < BLOCKED_SHARE else []
    places += [_on_cranium(head, np.array(pin)) for pin in PINS]
    for _ in range(int(random.integers(*ENTRIES))):
        entry = _direction(random.uniform(*ENTRY_AZIMUTH_DEG), random.uniform(*ENTRY_ELEVATION_DEG))
        places.append(_on_cranium(head, entry))
    lifted = np.zeros(len(points_mm))
    for centre in _project(head, np.array(places) + head.centre_ct_mm):
        injected_ml = random.uniform(*INJECTED_ML)
        radius_mm = random.uniform(*WHEALS_MM) * np.cbrt(injected_ml)
        left_mm3 = MM3_PER_ML * injected_ml * random.uniform(*LEFT_SHARE)
        squared = np.square(points_mm - centre).sum(axis=1) / radius_mm**2
        dome = np.maximum(1.0 - squared, 0.0) ** 2  # of volume a third of its height times its area
        lifted += 3.0 * left_mm3 / (np.pi * radius_mm**2) * dome
    return np.asarray(WHEAL_SHARE * lifted)


def _steroid_face(
    head: ParametricHead, points_mm: Array, length_mm: float, random: np.random.Generator
) -> Array:
    """Round or thin cheeks, jaw and neck, and thin the temples, as weeks of treatment do."""
    own, marks = points_mm - head.centre_ct_mm, head.landmarks
    sideways = np.abs(head.normals(points_mm)[:, 0])
    fat = random.normal(*FULLER) * blend_bodies(FAT, head, points_mm)
    fat *= IN_FRONT + (1.0 - IN_FRONT) * sideways
    temple_y = 0.5 * (marks.eye(head.face)[1] + marks.ear[1])
    along, up = own[:, 1] - temple_y, own[:, 2] - marks.sellion_mm - TEMPLE_ABOVE_SELLION_MM
    temple = np.exp(-0.5 * ((along / TEMPLE_MM[0]) ** 2 + (up / TEMPLE_MM[1]) ** 2)) * sideways
    muscle = TEMPLE_SHARE * abs(random.standard_normal()) * temple
    on_left = expit(4.0 * own[:, 0] / MIDDLE_MM)
    left, right = random.uniform(*SIDES, size=2)
    uneven = 1.0 + UNEVEN * field(random, UNEVEN_MM).at(points_mm)
    return np.asarray(STEROID_SHARE * (fat - muscle) * (right + (left - right) * on_left) * uneven)


def _fluid(head: ParametricHead, points_mm: Array, length_mm: float, random: np.random.Generator) -> Array:
    """Gather or resorb a layer of fluid under the scalp."""
    own, marks = points_mm - head.centre_ct_mm, head.landmarks
    centre = _on_cranium(
        head, _direction(random.uniform(*FLUID_AZIMUTH_DEG), random.uniform(*FLUID_ELEVATION_DEG))
    )
    radius_mm, edge_mm = random.uniform(*FLUID_RADII_MM), random.uniform(*FLUID_EDGES_MM)
    from_centre = own - centre
    away = np.linalg.norm(from_centre, axis=1) + WAVE_MM * field(random, WAVY_MM).at(points_mm)
    brow, ear = marks.sellion_mm + BROW_ABOVE_SELLION_MM, marks.ear[2]
    angle_deg = np.degrees(np.arctan2(np.abs(own[:, 0]), -own[:, 1]))
    border = np.interp(angle_deg, GALEA_DEG, (brow, brow, ear + OVER_EAR_MM, ear + OVER_NUCHA_MM))
    within = expit((radius_mm - away) / edge_mm) * expit((own[:, 2] - border) / GALEA_EDGE_MM)
    down = np.array([0.0, 1.0, 0.0]) if random.uniform() < SUPINE_SHARE else np.array([0.0, 0.0, -1.0])
    sunk = 1.0 + SINKING * np.tanh(from_centre @ down / radius_mm)
    amount = FLUID_SHARE * random.standard_normal()
    return np.asarray(amount * within * sunk * blend_bodies(ON_SKULL, head, points_mm))


def _film(head: ParametricHead, points_mm: Array, length_mm: float, random: np.random.Generator) -> Array:
    """Cover the skin of the field with a film that bridges hollows and throws wrinkles."""
    own, normals = points_mm - head.centre_ct_mm, head.normals(points_mm)
    centre = _on_cranium(
        head, _direction(random.uniform(*FILM_AZIMUTH_DEG), random.uniform(*FILM_ELEVATION_DEG))
    )
    away = np.linalg.norm(own - centre, axis=1)
    covered = expit((random.uniform(*FILM_RADII_MM) - away) / FILM_EDGE_MM)
    lower_edge = head.landmarks.sellion_mm + random.uniform(*FILM_ENDS_MM)
    covered *= expit((own[:, 2] - lower_edge) / FILM_EDGE_MM)
    turn = Rotation.random(rng=random)
    pull = turn.apply([1.0, 0.0, 0.0])
    along = pull - (normals @ pull)[:, None] * normals
    along /= np.sqrt(np.square(along).sum(axis=1) + SLACK**2)[:, None]
    span = random.uniform(*BRIDGED_MM) * along
    hollow_mm = -0.5 * (head.distance_mm(points_mm + span) + head.distance_mm(points_mm - span))
    tent = TENT_MM * np.tanh(np.maximum(hollow_mm, 0.0) / TENT_MM)
    creases = field(random, 1.0).at(turn.inv().apply(own) / CREASE_LENGTHS_MM)
    height = random.uniform(*CREASE_MM) * np.maximum(field(random, CREASED_MM).at(points_mm), 0.0)
    creased = height * np.exp(-0.5 * (creases / CREST) ** 2)
    raised = random.uniform(*FILM_MM) + random.uniform() * tent + creased
    return np.asarray(FILM_SHARE * covered * raised)


def _streaks(head: ParametricHead, points_mm: Array, length_mm: float, random: np.random.Generator) -> Array:
    """Shift the level of the skin where streaks of metal in the CT cross it."""
    marks, (half_mm, depth_mm) = head.landmarks, ARCH_MM
    slices = Rotation.from_euler("x", random.uniform(*GANTRY_DEG), degrees=True)
    metals: list[tuple[Array, float]] = []
    for _ in range(int(random.integers(*FILLINGS))):
        x = half_mm * random.uniform(-1.0, 1.0)
        y = marks.face_front_mm + TEETH_BEHIND_MM + depth_mm * (x / half_mm) ** 2
        metals.append((np.array([x, y, marks.mouth_mm + CROWN_SD_MM * random.standard_normal()]), FILLING))
    if random.uniform() < PLATED_SHARE:
        middle = _on_cranium(
            head, _direction(random.uniform(*PLATE_AZIMUTH_DEG), random.uniform(*PLATE_ELEVATION_DEG))
        )
        for _ in range(PLATES):
            beside = PLATE_CIRCLE_MM * random.standard_normal(3) / np.sqrt(2.0)
            plate = _project(head, (middle + beside + head.centre_ct_mm)[None])
            under = plate - soft_mm(head, plate)[:, None] * head.normals(plate)
            metals.append((under[0] - head.centre_ct_mm, TITANIUM))
    rays, shifted = np.arange(*RAYS), np.zeros(len(points_mm))
    for place, strength in metals:
        x, y, z = slices.apply(points_mm - head.centre_ct_mm - place).T
        waves = random.standard_normal(len(rays)) * np.sqrt(2.0 / len(rays))
        phases = random.uniform(0.0, 2.0 * np.pi, len(rays))
        around = np.cos(np.arctan2(y, x)[:, None] * rays + phases) @ waves
        fading = np.sqrt(NEAR_MM / (NEAR_MM + np.hypot(x, y)))
        shifted += strength * around * fading * np.exp(-0.5 * (z / random.uniform(*STREAKS_MM)) ** 2)
    size = STREAK_SHARE * random.uniform(*STREAK_SIZES)
    return np.asarray(size * STREAK_LIMIT * np.tanh(shifted / STREAK_LIMIT))


def _ears(head: ParametricHead, points_mm: Array, length_mm: float, random: np.random.Generator) -> Array:
    """Bend the ears about their front edges, and their tops aside."""
    own, normals = points_mm - head.centre_ct_mm, head.normals(points_mm)
    side = np.sign(own[:, 0])
    ear, face = head.landmarks.ear, head.face
    x, y, z = (own * np.column_stack([side, np.ones((len(side), 2))]) - ear).T
    ear_distance = head.parts(*np.ascontiguousarray(points_mm.T)).ear.value
    on_ear = expit((EAR_REACH_MM - ear_distance) / EAR_EDGE_MM)
    behind = np.hypot(x, y) / face.ear_breadth_mm
    height = z / (0.5 * face.ear_length_mm)
    both, left, right, left_top, right_top = random.standard_normal(5)
    alike, apart = np.sqrt(EARS_ALIKE), np.sqrt(1.0 - EARS_ALIKE)
    turn = alike * both + apart * np.where(side > 0.0, left, right)
    top = TOP_OUT * np.where(side > 0.0, left_top, right_top)
    bent = turn * behind * (1.0 + UPPER_HALF * np.tanh(height)) + top * np.maximum(height, 0.0) ** 2
    # The plate's outward direction: its edge stands off by the protrusion
    open_sine = min(face.ear_protrusion_mm / face.ear_breadth_mm, 1.0)
    outwards = np.array([np.sqrt(1.0 - open_sine**2), -open_sine, 0.0])
    facing = normals[:, 0] * side * outwards[0] + normals[:, 1] * outwards[1]
    return np.asarray(EAR_SHARE * bent * on_ear * facing)


def _nerves(head: ParametricHead) -> list[Array]:
    """Return places (3,) near the nerves of the scalp on both sides, from the cranium's centre."""
    marks, back = head.landmarks, (0.0, head.semi_axes_mm[1], head.landmarks.ear[2])
    starts = ((marks.eye(head.face), FROM_EYE_MM), (marks.ear, FROM_EAR_MM), (back, FROM_BACK_MM))
    left = [np.add(start, offset) for start, offsets in starts for offset in offsets]
    return [place * (side, 1.0, 1.0) for place in left for side in (1.0, -1.0)]


def _direction(azimuth_deg: float, elevation_deg: float) -> Array:
    """Return the unit direction (3,) of an angle from the front to the left and one upwards."""
    azimuth, elevation = np.radians((azimuth_deg, elevation_deg))
    level = np.cos(elevation)
    return np.array([level * np.sin(azimuth), -level * np.cos(azimuth), np.sin(elevation)])


def _on_cranium(head: ParametricHead, direction: Array) -> Array:
    """Return the place (3,) of a direction on the cranium, from its centre."""
    return np.asarray(direction / np.linalg.norm(direction / np.asarray(head.semi_axes_mm)))


def _project(head: ParametricHead, places_mm: Array) -> Array:
    """Return places (n, 3) of the CT moved onto the skin."""
    for _ in range(PROJECTIONS):
        places_mm = places_mm - head.distance_mm(places_mm)[:, None] * head.normals(places_mm)
    return places_mm


THIRD_JUDGED_KINDS: Mapping[Skin, Kind] = {
    Skin.WHEALS: _wheals,
    Skin.STEROIDS: _steroid_face,
    Skin.FLUID: _fluid,
    Skin.FILM: _film,
    Skin.STREAKS: _streaks,
    Skin.EARS: _ears,
}
