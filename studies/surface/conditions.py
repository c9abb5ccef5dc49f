"""Conditions of the study, frozen before it is judged.

The estimator was tuned on none of the judged skins, but with the development skins in view (decision 33). Its
own hypotheses, Matérn 1/2 and 3/2, are not among the judged ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from itertools import product

import numpy as np

from ronna_hw.arrays import Array
from studies.surface.kinds import Kinds

Direction = tuple[float, float, float]


class Coverage(StrEnum):
    """Parts of the head that are scanned."""

    ALL = "all"
    FRONT_AND_EARS = "front and ears"
    FACE = "face only"
    VAULT = "vault only"
    HAIR = "hat of hair"


class Hair(StrEnum):
    """Hair of the head that is scanned."""

    SHAVED = "shaved"
    AS_DRAWN = "as drawn"
    HAT = "thick and uncut"


class Skin(StrEnum):
    """Kinds of misfit between the skin in the theatre and in the CT."""

    RIGID = "rigid phantom"
    ROUGH = "Matérn 1/2"
    SMOOTH = "Matérn 5/2"
    SMOOTHEST = "squared exponential"
    PATCHES = "patches"
    SWELLING = "quadratic swelling"
    TAPE = "tape and jaw"
    PILLOW = "pillow and pins"
    SAG = "gravity on a turned head"
    OEDEMA = "one-sided oedema"
    SLICES = "movement during the CT"
    SCALE = "scale and tilt of the CT"
    BAND = "pressed band"
    FOLDS = "relaxed folds"
    PADS = "pads in the CT"
    HYDRATION = "hydration"
    SLIDE = "slid tissue"
    BLUR = "thick slices"
    TUBE = "tube at the mouth"
    BEARD = "grown beard"
    WHEALS = "wheals of local anaesthetic"
    STEROIDS = "face under steroids"
    FLUID = "fluid under the scalp"
    FILM = "adhesive film"
    STREAKS = "streaks of metal"
    EARS = "bent ears"
    CLENCHED = "clenched teeth"
    MASK = "marks of a mask"
    BRUISE = "bruise with a firm rim"
    MATTED = "hair shown as skin"
    STAIRS = "stairs of the slices"
    ROUNDED = "rounded surface"


JUDGED = (Skin.CLENCHED, Skin.MASK, Skin.BRUISE, Skin.MATTED, Skin.STAIRS, Skin.ROUNDED)
# These judged once each and were looked at afterwards (decision 33).
THIRD_JUDGED = (Skin.WHEALS, Skin.STEROIDS, Skin.FLUID, Skin.FILM, Skin.STREAKS, Skin.EARS)
SECOND_JUDGED = (Skin.PADS, Skin.HYDRATION, Skin.SLIDE, Skin.BLUR, Skin.TUBE, Skin.BEARD)
FIRST_JUDGED = (Skin.SAG, Skin.OEDEMA, Skin.SLICES, Skin.SCALE, Skin.BAND, Skin.FOLDS)
DEVELOPMENT = tuple(skin for skin in Skin if skin not in JUDGED)  # shown, but not judged


@dataclass(frozen=True)
class Scanned:
    """Directions from the head to the looks (patient coordinates: left, back, up), and the hair."""

    looks: tuple[Direction, ...]
    hair: Hair


FRONT: tuple[Direction, ...] = ((0.0, -1.0, 0.2), (1.0, -0.6, 0.2), (-1.0, -0.6, 0.2), (0.0, -0.7, 1.0))
SIDES: tuple[Direction, ...] = ((1.0, 0.2, 0.3), (-1.0, 0.2, 0.3))
COVERAGES: Mapping[Coverage, Scanned] = {
    Coverage.ALL: Scanned(FRONT + SIDES, Hair.AS_DRAWN),
    Coverage.FRONT_AND_EARS: Scanned(FRONT, Hair.AS_DRAWN),
    Coverage.FACE: Scanned(((0.0, -1.0, 0.0),), Hair.SHAVED),
    Coverage.VAULT: Scanned(
        ((0.0, -0.6, 1.0), (0.0, 0.0, 1.0), (0.5, -0.5, 1.0), (-0.5, -0.5, 1.0)), Hair.SHAVED
    ),
    Coverage.HAIR: Scanned(FRONT + SIDES, Hair.HAT),
}
# Of the development skins beside judged ones
SHOWN_BESIDE, SHOWN_SKINS = (Coverage.ALL, Coverage.FRONT_AND_EARS), (Skin.RIGID, Skin.ROUGH)
REFUSABLE = (Coverage.FACE, Coverage.HAIR)  # refused, or predicted honestly


def conditions(kinds: Kinds) -> list[tuple[Coverage, Skin]]:
    """Return the conditions: all coverages of these kinds; two skins of development beside judged ones."""
    if kinds is not Kinds.ALL:
        return list(product(Coverage, JUDGED if kinds is Kinds.JUDGED else DEVELOPMENT))
    return [
        (coverage, skin)
        for coverage, skin in product(Coverage, Skin)
        if skin in JUDGED or (skin in SHOWN_SKINS and coverage in SHOWN_BESIDE)
    ]


# Drawn for each registration
SIZE_MM = (0.1, 0.8)  # standard deviation of a field, uniform in its logarithm; other kinds have less of it
LENGTH_MM = (12.0, 50.0)  # over which it is correlated, likewise
OFFSETS_MM = (0.0, 0.1, 0.2)  # standard deviation of the surface's level in the CT
NOISES_MM = (0.03, 0.1, 0.3)  # of a point along the ray of light, standard deviation

# Of the start by the tracker, standard deviations
START_TURN_RAD, START_MM = float(np.radians(2.0)), 3.0

# Depth of the targets below the skin, and how many of each
DEPTHS_MM: Mapping[str, tuple[float, float]] = {
    "superficial": (10.0, 25.0),
    "middle": (30.0, 45.0),
    "deep": (50.0, 75.0),
}
TARGETS_EACH = 2

SHIFTED = "a third shifted by 1 mm"  # condition of its own
SHIFTS, SHIFTS_EACH = 100, 10  # scans, and how many of them of one head
SHIFT_MM, SHIFTED_SHARE, SHIFT_EDGE_MM = 1.0, 1.0 / 3.0, 5.0
SHIFT_COVERAGE, SHIFT_SKIN, SHIFT_SIZE_MM = Coverage.FRONT_AND_EARS, Skin.SMOOTHEST, 0.1


@dataclass(frozen=True)
class Draw:
    """Drawn values of one registration: misfit and its length, offset of the CT's level, noise; in mm."""

    size_mm: float
    length_mm: float
    offset_sd_mm: float
    offset_mm: float
    noise_mm: float

    @classmethod
    def of(cls, random: np.random.Generator) -> Draw:
        """Draw all values."""
        offset_sd_mm = float(random.choice(OFFSETS_MM))
        return cls(
            size_mm=_log_uniform(SIZE_MM, random),
            length_mm=_log_uniform(LENGTH_MM, random),
            offset_sd_mm=offset_sd_mm,
            offset_mm=offset_sd_mm * float(random.standard_normal()),
            noise_mm=float(random.choice(NOISES_MM)),
        )


def _log_uniform(limits: tuple[float, float], random: np.random.Generator) -> float:
    low, high = np.log(limits)
    return float(np.exp(random.uniform(low, high)))


def unit_directions(directions: tuple[Direction, ...]) -> Array:
    """Return directions (n, 3) of length one."""
    array = np.array(directions)
    return np.asarray(array / np.linalg.norm(array, axis=1, keepdims=True))
