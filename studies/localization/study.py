"""Sphere localization in phantom CTs by our method and the thesis' two, on families not used for tuning.

Also the protocols of the thesis' tables 2 and 3: five scans of one frame of four spheres are registered to
its known coordinates and to each other, and FLE is computed from FRE. Human picks are simulated with the FLE
that the thesis reports for its four operators, so those rows check the protocol, not the people.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations, product
from typing import ClassVar

import numpy as np

from procedures.imaging import Localization, Volume, localize_picks
from procedures.imaging.errors import MarkerCountWrong, PickRefused
from procedures.imaging.localizers import LOCALIZERS, Localizer, LocalizerDescription
from procedures.imaging.markers import ESTIMATORS_DISAGREE, Marker
from procedures.registration.point_registration import register
from ronna_hw.arrays import Array
from ronna_hw.x_frame import SPHERE_CENTRES_MM
from studies.campaign.study import Study, Sums, Unit, as_sums, blocks, blocks_of_each, generator
from studies.errors import NOT_FOR_JUDGING
from studies.localization.phantom_scans import PhantomScan, phantom_scan
from studies.plugins.answers import PluginLocalizer
from studies.plugins.method import PluginMethod
from studies.thesis_tables import OPERATORS, TABLE_3

BESIDE_OBJECTS = ("ends", "plates", "hollow", "fittings")  # that are not spheres
COVERED = ("bandage", "soaked")
STREAKED = ("streaks", "rays", "posts", "screws")  # families whose posts cause streaks
JUDGING = (
    *("narrow", "broad", "clamp", "electrodes", "crowded", "edge", "streaks", "rays"),
    *COVERED,
    *BESIDE_OBJECTS,
)
TUNING = ("plain", "posts", "bands", "dressing", "rounded", "joined", "caps", "sizes", "screws")
PROTOCOLS = ("good", "poor")
FRAMES = "frames"
FRAME_FAMILIES = ("narrow", "broad", "clamp", "electrodes", "streaks")  # a set is one scan of each
FRAME_PROTOCOL = "usual"
SAME_SPHERE_MM = 2.0
LARGE_ERROR_MM = 0.1
TAIL = 0.01  # share of errors outside the stated 99 % region
CHI2_AT_TAIL = 11.345  # of three degrees of freedom
BIN_MM = 0.001
SEED_BOUND = 2**31
OPERATORS_FLE_MM = tuple(TABLE_3[operator].printed_mm for operator in OPERATORS)
SUMS = "squares, fourth powers and tails"  # older campaigns lack these sums, which the bounds need
OURS = LOCALIZERS[Localizer.OURS].method
AUTOMATIC = tuple(one.method for one in LOCALIZERS.values())
PERSON, REFINED = "person", "person's picks refined"


@dataclass(frozen=True)
class LocalizationStudy(Study):
    """Localization study by number of volumes per family and protocol, and of five-scan frame sets."""

    volumes: int
    sets: int = 1
    seed: int = 0
    families: tuple[str, ...] = JUDGING
    protocols: tuple[str, ...] = PROTOCOLS
    name: str = "localization"
    own: tuple[PluginMethod, ...] = ()

    constants: ClassVar = {"sums": SUMS}

    def units(self) -> Sequence[Unit]:
        """Return one unit per volume, then one per set of frame scans."""
        conditions = ((family, protocol) for protocol, family in product(self.protocols, self.families))
        volumes = blocks_of_each(conditions, self.volumes, 1)
        return [*volumes, *blocks(f"{FRAMES}|{FRAME_PROTOCOL}", self.sets, 1)]

    def run(self, unit: Unit) -> Sums:
        """Return counts and sums of squares (mm2) for one volume or one set of frame scans."""
        family, protocol = unit.condition.split("|")
        random = generator(self.seed, unit)
        sums: Counter[str] = Counter()
        own = tuple(PluginLocalizer.of(one) for one in self.own)
        if family == FRAMES:
            sums.update(_localize_frame_set(random, own))
        else:
            with phantom_scan(family, protocol, int(random.integers(SEED_BOUND))) as scan:
                if family in JUDGING and scan.purpose != "judging":
                    raise NOT_FOR_JUDGING(f"family {family} is for {scan.purpose}")
                sums.update({"volumes": 1.0, "objects": scan.objects, "bound2": scan.bound_mm**2})
                for built_in in LOCALIZERS.values():
                    sums.update(_count_localization(built_in, scan))
                for localizer in own:
                    sums.update(_count_outcomes(localizer.name, localizer(scan.volume), (), scan))
        return as_sums(sums)


def localize_by(localizer: LocalizerDescription, volume: Volume) -> Localization | None:
    """Localize by a built-in localizer, or return None if the marker count is implausible."""
    try:
        return localizer.load()(volume)
    except MarkerCountWrong:
        return None


def _count_localization(localizer: LocalizerDescription, scan: PhantomScan) -> Sums:
    result = localize_by(localizer, scan.volume)
    found_mm, markers = (None, ()) if result is None else (result.centres_mm, result.markers)
    return _count_outcomes(localizer.method, found_mm, markers, scan)


def _count_outcomes(who: str, found_mm: Array | None, markers: Sequence[Marker], scan: PhantomScan) -> Sums:
    """Count hits, misses and errors in a volume. Covariances are judged only if `markers` are given.

    Spheres cut by the field of view count neither as missed nor as false.
    """
    sums: dict[str, float] = defaultdict(float, spheres=scan.whole.sum(), cut=(~scan.whole).sum())
    found = np.empty((0, 3)) if found_mm is None else found_mm
    distance = np.linalg.norm(found[:, None] - scan.centres_mm[None], axis=2)
    near = distance < SAME_SPHERE_MM
    sums["false"] = len(found) - int(near.any(axis=0).sum())  # a second one near a sphere is false too
    for sphere, centre in enumerate(scan.centres_mm):
        if not near[:, sphere].any():
            sums["missed" if scan.whole[sphere] else "cut missed"] += 1
            continue
        if not scan.whole[sphere]:
            sums["cut found"] += 1
            continue
        hit = int(distance[:, sphere].argmin())
        error = found[hit] - centre
        length_mm = float(np.linalg.norm(error))
        sums["found"] += 1
        sums["error2"] += length_mm**2
        sums["error4"] += length_mm**4
        sums[f"bin {int(length_mm / BIN_MM)}"] += 1
        if not markers:
            continue
        marker = markers[hit]
        chi2 = float(error @ np.linalg.solve(marker.covariance_mm2, error))
        sums["chi2"] += chi2
        sums["tail"] += chi2 > CHI2_AT_TAIL
        if length_mm > LARGE_ERROR_MM:
            sums["large"] += 1
            sums["large flagged"] += ESTIMATORS_DISAGREE in marker.flags
    return as_sums({f"{who}|{key}": value for key, value in sums.items()})


def _localize_frame_set(random: np.random.Generator, own: Sequence[PluginLocalizer]) -> Sums:
    """Localize five scans of the frame. Return each method's FREs to the frame and between scans."""
    points: dict[str, list[Array]] = defaultdict(list)
    for family in FRAME_FAMILIES:
        seed = int(random.integers(SEED_BOUND))
        with phantom_scan(family, FRAME_PROTOCOL, seed, "xframe") as scan:
            found: dict[str, Array | None] = {}
            for built_in in LOCALIZERS.values():
                result = localize_by(built_in, scan.volume)
                found[built_in.method] = None if result is None else result.centres_mm
            found |= {localizer.name: localizer(scan.volume) for localizer in own}
            picks: list[Array] = []
            for number, fle_mm in enumerate(OPERATORS_FLE_MM, start=1):
                picks.append(scan.centres_mm + random.normal(size=(4, 3)) * fle_mm / np.sqrt(3.0))
                points[f"{PERSON} {number}"].append(picks[-1])
            found[REFINED] = _refine_picks(scan, picks[0])
            for who, found_mm in found.items():
                ordered = None if found_mm is None else _match_in_order(found_mm, scan.centres_mm)
                if ordered is not None:
                    points[who].append(ordered)
    return fle_sums(points)


def fle_sums(points: Mapping[str, Sequence[Array]]) -> Sums:
    """Sum the squared FREs (mm2) of all scans (4, 3), to the frame's coordinates and to each other."""
    frame = np.array(SPHERE_CENTRES_MM)
    sums: dict[str, float] = defaultdict(float, sets=1.0)
    for who, scans in points.items():
        for one in scans:
            sums[f"{who}|truth fre2"] += register(frame, one).fre_mm ** 2
            sums[f"{who}|truth runs"] += 1
        for one, other in combinations(scans, 2):
            sums[f"{who}|pair fre2"] += register(one, other).fre_mm ** 2
            sums[f"{who}|pair runs"] += 1
    return as_sums(sums)


def _refine_picks(scan: PhantomScan, picks_mm: Array) -> Array | None:
    with suppress(PickRefused):
        return localize_picks(scan.volume, picks_mm).centres_mm
    return None


def _match_in_order(found_mm: Array, centres_mm: Array) -> Array | None:
    """Reorder the found points like the true ones, or return None unless they match one to one."""
    if len(found_mm) == 0:
        return None
    distance = np.linalg.norm(found_mm[:, None] - centres_mm[None], axis=2)
    nearest = distance.argmin(axis=0)
    whole = bool((distance.min(axis=0) < SAME_SPHERE_MM).all()) and len(set(nearest.tolist())) == len(
        centres_mm
    )
    return found_mm[nearest] if whole else None
