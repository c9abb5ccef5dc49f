"""Scene families for the phantom CT, and their scan protocols.

The localizer's thresholds may be chosen on the families for TUNING. Its accuracy, detection and calibration
of covariances are stated for the families for JUDGING, which are never used while changing the localizer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from math import cos, pi, sin

import numpy as np

from sim.phantom.head.anatomy import METAL_HU, POST_METAL_HU, SkinMarker, shift_point
from sim.phantom.head.look_alikes import CAPS, ENDS, FITTINGS, HOLLOW, JOINED, PLATES, ROUNDED, SIZES, Draw
from sim.phantom.head.painting import Band
from sim.world.scene.model import CtProtocol

Range = tuple[float, float]

PAIR_DISTANCE_MM = 14.0

PROTOCOLS: dict[str, CtProtocol] = {
    "good": CtProtocol(),
    "usual": CtProtocol(pixel_mm=0.6, slice_mm=1.25, columns=426, rows=426, slices=160, noise_HU=35.0),
    "fine": CtProtocol(pixel_mm=0.45, slice_mm=0.6, columns=512, rows=512, slices=280, noise_HU=25.0),
    "poor": CtProtocol(pixel_mm=0.7, slice_mm=2.0, columns=366, rows=366, slices=100, noise_HU=50.0),
}

PASSING_MM = 40.0  # half the length of a band that passes a sphere
RAY_MM = 25.0  # half the length of a band that starts at metal


class Purpose(StrEnum):
    """Intended use of a family."""

    TUNING = "tuning"
    JUDGING = "judging"


class Headrest(StrEnum):
    """Head support."""

    TROUGH = "trough"
    CUSHION = "cushion"  # a flat block of foam on a board
    NONE = "none"


@dataclass(frozen=True)
class PostStreaks:
    """Metal streaks from the markers: peak intensity, fall-off distance and number of lobes."""

    hu: Range
    fall_mm: Range
    lobes: tuple[int, ...]


@dataclass(frozen=True)
class MarkerBands:
    """Straight bright or dark streaks: how many, and where near each marker.

    `from_metal`: they start at the post's foot and miss its axis by `beside_mm`; otherwise they pass the
    sphere.
    """

    count: tuple[int, int]
    hu: Range
    width_mm: Range
    height_mm: Range
    beside_mm: Range
    below_mm: Range  # the sphere's centre
    from_metal: bool = False


@dataclass(frozen=True)
class MetalBases:
    """Markers on metal screws, scanned with the artefacts that the metal causes.

    Post radius and flange thickness; `beside` is the share of markers with more metal at `beside_mm` from the
    sphere's centre. The kernel is drawn, too.
    """

    hu: tuple[float, ...]
    radius_mm: Range
    flange_mm: Range
    beside: float
    beside_mm: Range
    kernels: tuple[str, ...]


@dataclass(frozen=True)
class Family:
    """A scan family, from whose ranges each scan draws its values uniformly."""

    name: str
    shows: str
    half_width_mm: Range = (72.0, 78.0)  # semi-axes of the head
    half_depth_mm: Range = (90.0, 98.0)
    half_height_mm: Range = (86.0, 94.0)
    markers: int = 7
    standoff_mm: Range = (12.0, 20.0)  # skin to a sphere's centre
    fillings: tuple[int, int] = (3, 6)
    headrest: Headrest = Headrest.TROUGH
    cable: bool = True
    pins: int = 0  # of a head clamp
    electrodes: int = 0  # on the skin, with their leads
    bolts: int = 0  # of depth electrodes, in the skull
    bandage_mm: Range | None = None  # thickness
    bandage_hu: Range = (-100.0, 0.0)
    post_streaks: PostStreaks | None = None
    bands: MarkerBands | None = None
    pairs: int = 0  # spheres that get a neighbour
    distractors: int = 0  # polymer balls and cylinders, this many of each
    look_alikes: tuple[Draw, ...] = ()  # objects that are not spheres, two of each kind
    bases: MetalBases | None = None
    bare: bool = False  # spheres have neither film nor post
    edge: bool = False  # the field of view ends next to one sphere and cuts another
    purpose: Purpose = Purpose.TUNING


def _look_alikes(name: str, shows: str, look_alikes: tuple[Draw, ...]) -> Family:
    return Family(name, shows, headrest=Headrest.NONE, cable=False, look_alikes=look_alikes, markers=5)


def _for_purpose(purpose: Purpose, *families: Family) -> dict[str, Family]:
    return {family.name: replace(family, purpose=purpose) for family in families}


TUNING = _for_purpose(
    Purpose.TUNING,
    Family("plain", "an ordinary head in a head holder, with dental fillings and a cable"),
    Family(
        "posts",
        "two-lobed streaks around every metal post",
        post_streaks=PostStreaks((250.0, 250.0), (2.0, 2.0), (2,)),
    ),
    Family(
        "bands",
        "one or two straight bright or dark bands across every sphere",
        bands=MarkerBands((1, 2), (150.0, 450.0), (1.2, 3.0), (1.0, 3.0), (-6.0, 6.0), (-5.0, 5.0)),
    ),
    Family(
        "dressing",
        "a moist bandage that covers spheres up to the middle",
        bandage_mm=(6.0, 14.0),
        bandage_hu=(20.0, 60.0),
    ),
    Family(
        "screws",
        "metal screws and their artefacts from the physics of the scan, other metal beside them",
        standoff_mm=(9.0, 16.0),
        bases=MetalBases(
            (POST_METAL_HU, METAL_HU), (1.2, 2.0), (1.2, 2.0), 0.4, (9.0, 15.0), ("standard", "sharp")
        ),
        cable=False,
    ),
    _look_alikes("rounded", "capsules, rods with round ends and ellipsoids", ROUNDED),
    _look_alikes("caps", "domes on the skin, mushroom shapes, barrels, buttons", CAPS),
    _look_alikes("joined", "beads in rows and balls on thick rods", JOINED),
    _look_alikes("sizes", "balls half a millimetre smaller than markers", SIZES),
)
JUDGING = _for_purpose(
    Purpose.JUDGING,
    Family(
        "narrow",
        "a small, long head on a cushion, many dental fillings",
        half_width_mm=(60.0, 66.0),
        half_depth_mm=(84.0, 92.0),
        half_height_mm=(76.0, 84.0),
        fillings=(6, 12),
        headrest=Headrest.CUSHION,
        cable=False,
    ),
    Family(
        "broad",
        "a large round head without headrest, with bolts of depth electrodes",
        half_width_mm=(80.0, 86.0),
        half_depth_mm=(94.0, 102.0),
        half_height_mm=(92.0, 98.0),
        headrest=Headrest.NONE,
        bolts=6,
    ),
    Family(
        "clamp",
        "a head clamp with three steel pins and their streaks",
        headrest=Headrest.NONE,
        pins=3,
        cable=False,
    ),
    Family("electrodes", "cup electrodes with leads between the markers", electrodes=10),
    Family("bandage", "a dry bandage around the head", bandage_mm=(3.0, 10.0), headrest=Headrest.CUSHION),
    Family(
        "soaked",
        "a wet bandage that covers spheres up to the middle",
        bandage_mm=(7.0, 15.0),
        bandage_hu=(-30.0, 40.0),
        headrest=Headrest.CUSHION,
        cable=False,
    ),
    Family(
        "crowded",
        "pairs of spheres 14 mm apart, balls of 16 mm and cylinders of 12 mm of the same polymer",
        pairs=2,
        distractors=4,
    ),
    Family("edge", "the field of view ends next to one sphere and cuts another", edge=True),
    Family(
        "streaks",
        "three- to five-lobed streaks around every metal post",
        post_streaks=PostStreaks((200.0, 250.0), (2.0, 2.5), (3, 4, 5)),
        fillings=(6, 12),
    ),
    Family(
        "rays",
        "three to six bright and dark rays from the foot of every post, in adjacent slices",
        bands=MarkerBands(
            (3, 6), (200.0, 500.0), (0.8, 2.5), (1.5, 4.0), (-2.0, 2.0), (3.0, 9.0), from_metal=True
        ),
        fillings=(6, 12),
    ),
    Family(
        "metal",
        "titanium and steel screws, amalgam and screws beside them, and their artefacts from the physics",
        half_width_mm=(70.0, 80.0),
        standoff_mm=(9.0, 18.0),
        bases=MetalBases(
            (POST_METAL_HU, POST_METAL_HU, METAL_HU),
            (1.2, 2.0),
            (1.2, 2.0),
            0.5,
            (8.5, 16.0),
            ("standard", "smooth", "sharp"),
        ),
        headrest=Headrest.CUSHION,
        cable=False,
    ),
    Family(
        "bare",
        "spheres without film and post, which do not exist: the error due to noise alone",
        headrest=Headrest.NONE,
        cable=False,
        bare=True,
    ),
    _look_alikes("ends", "elbows, tapered and plain rods with round ends", ENDS),
    _look_alikes("plates", "domes on plates and over metal discs, merged balls", PLATES),
    _look_alikes("hollow", "hollow balls, balls of other sizes, gel with bubbles, rings", HOLLOW),
    _look_alikes("fittings", "artificial teeth, balls with a metal core, balls on a pin", FITTINGS),
)
FAMILIES = TUNING | JUDGING


def draw_bands(
    kind: MarkerBands | None, markers: tuple[SkinMarker, ...], generator: np.random.Generator
) -> tuple[Band, ...]:
    """Draw the bands of each marker, or none if the family has no bands."""
    if kind is None:
        return ()
    return tuple(
        _draw_band(kind, marker, generator)
        for marker in markers
        for _ in range(int(generator.integers(kind.count[0], kind.count[1] + 1)))
    )


def _draw_band(kind: MarkerBands, marker: SkinMarker, generator: np.random.Generator) -> Band:
    angle = float(generator.uniform(0.0, 2.0 * pi))
    sign = float(generator.choice((-1.0, 1.0)))
    below = float(generator.uniform(*kind.below_mm))
    beside = float(generator.uniform(*kind.beside_mm))
    fiducial = marker.fiducial
    if kind.from_metal:
        middle = shift_point(fiducial.centre_ct_mm, fiducial.post_ct, -below)
        middle = shift_point(middle, (cos(angle), sin(angle), 0.0), RAY_MM)
    else:
        middle = shift_point(fiducial.centre_ct_mm, (0.0, 0.0, -1.0), below)
    return Band(
        shift_point(middle, (-sin(angle), cos(angle), 0.0), beside),
        sign * float(generator.uniform(*kind.hu)),
        angle,
        float(generator.uniform(*kind.width_mm)),
        float(generator.uniform(*kind.height_mm)),
        RAY_MM if kind.from_metal else PASSING_MM,
    )
