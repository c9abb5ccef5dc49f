"""Identity of stray markers from frame to frame: which reading is the same sphere as before.

A tracker reports strays in no fixed order: spheres change places in the list from one frame to the next. A
standard deviation taken by place in the list is the distance between spheres, not the noise of one.

Readings are paired with the last known positions of the spheres within a gate, nearest first. An identity is
never carried on by a guess. It ends where

- readings and known spheres could be paired in more than one way within the gate, as when two spheres meet;
- known spheres are missing while as many new ones appear: tracker or head was moved between two frames;
- a sphere was hidden while the others moved.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from ronna_hw.arguments import WrongArgument, require_numbers, show
from ronna_hw.arrays import Array
from ronna_hw.devices.crossed_sight import TRACK, describe_crossed_sights, find_crossed_sights
from ronna_hw.devices.errors import BAD_STRAYS
from ronna_hw.devices.readings import TrackerFrame, Validity
from ronna_hw.devices.strays import (
    GATE_MM,
    LEAST_SHARE,
    pair_nearest,
    require_frames,
    require_positions,
    select_strays,
)
from ronna_hw.frames import Frame
from ronna_hw.text import format_names
from ronna_hw.vectors import Vector3

KNOWN_AFTER = 3  # frames; a reflection that flickers is forgotten before
# Missing spheres, with as many new ones, that show a moved scene; reflections may appear as others hide.
FEWEST_MOVED = 2  # from one frame to the next
FEWEST_MOVED_UNSEEN = 3  # while they were hidden
CALLING_LEVEL = 2  # of the stack from `track_strays`: who called it
POSED = (Validity.OK, Validity.PARTIAL)  # readings of a tool that say where its markers are
LEAST_TOOL_MM = 5.0  # extent of a tool's markers; in metres it would be below 1
UNKNOWN = -1  # identity of a reading that may belong to more than one sphere


class StrayWarning(UserWarning):
    """Tracks of strays cannot be taken as they are: phantoms, places outside the volume, no frames."""


@dataclass(frozen=True)
class StrayTrack:
    """One stray sphere in the frames in which it was seen, in tracker coordinates."""

    identity: int  # in the order of first appearance
    device_clock: NDArray[np.int64]  # (n,) the tracker's own count of frames
    positions_mm: Array  # (n, 3)


@dataclass
class _Sphere:
    last_mm: Array
    identity: int | None  # None while it cannot be told from another
    count: int = 0  # of frames in which it was seen
    drift_mm: Array = field(default_factory=lambda: np.zeros(3))  # of the others since it was last seen

    in_last_frame: bool = True

    @property
    def is_known(self) -> bool:
        return self.count >= KNOWN_AFTER


_NEW = _Sphere(np.zeros(3), None)


def track_strays(
    frames: Iterable[TrackerFrame],
    *,
    markers_mm: Mapping[str, Sequence[Vector3]] | None = None,
    gate_mm: float = GATE_MM,
    least_share: float = LEAST_SHARE,
) -> tuple[StrayTrack, ...]:
    """Track stray spheres across unordered frames.

    A StrayWarning names tracks that no sphere explains: phantoms, where lines of sight to two others cross.
    With `markers_mm`, as `tracker.markers_mm`, it also names those of a sphere and a marker of a tool at
    rest; frames alone do not tell where such markers are.

    Left out are repeated measurements (STALE), readings that may belong to more than one sphere, and what
    fewer than `least_share` of the frames show, such as reflections; with a StrayWarning also positions
    outside the measuring volume. `gate_mm` is the farthest that a sphere may move between two frames. Raises
    DEV-005, and ARG-001 for anything else than frames.
    """
    if not 0.0 <= least_share <= 1.0:
        raise BAD_STRAYS("the share must be between 0 and 1", got=f"{least_share}")
    kept = tuple(require_frames(frames))
    if not kept:
        text = "there are no frames; new_frames and a stream give each frame once: keep them in a list."
        warnings.warn(text, StrayWarning, stacklevel=2)
    read = select_strays(kept)
    identities_by_frame = identify_strays([positions for _, positions in read], gate_mm=gate_mm)
    seen: dict[int, list[tuple[int, Vector3]]] = {}
    for (frame, positions), identities in zip(read, identities_by_frame, strict=True):
        for identity, position_mm in zip(identities.tolist(), positions, strict=True):
            seen.setdefault(identity, []).append((frame.stamp.device_clock, position_mm))
    seen.pop(UNKNOWN, None)
    tracks = tuple(
        StrayTrack(
            identity,
            np.array([clock for clock, _ in readings], dtype=np.int64),
            np.array([position_mm for _, position_mm in readings], dtype=float),
        )
        for identity, readings in sorted(seen.items())
        if len(readings) >= least_share * len(read)
    )
    _warn_of_phantoms(tracks, locate_markers(kept, markers_mm or {}))
    outside = sum(_has_strays_outside(frame) for frame, _ in read)
    if outside and outside >= least_share * len(read):
        text = f"strays outside the measuring volume are left out: {outside} of {len(read)} frames show some."
        warnings.warn(text, StrayWarning, CALLING_LEVEL)
    return tracks


def _has_strays_outside(frame: TrackerFrame) -> bool:
    return any(one.validity is Validity.OUT_OF_VOLUME for one in frame.strays)


def _warn_of_phantoms(tracks: Sequence[StrayTrack], markers: Mapping[str, Array]) -> None:
    """Warn of tracks that are where lines of sight to two others cross, or to one and a known marker."""
    places = [*(one.positions_mm.mean(axis=0) for one in tracks), *markers.values()]
    found = [one for one in find_crossed_sights(_stack(places)) if one.track < len(tracks)]
    if sentences := describe_crossed_sights(found, [*(f"{TRACK}{one.identity}" for one in tracks), *markers]):
        text = f"{'; '.join(sentences)}. Hide one sphere: its phantoms go with it."
        warnings.warn(text, StrayWarning, CALLING_LEVEL + 1)


def locate_markers(
    frames: Sequence[TrackerFrame], markers_mm: Mapping[str, Sequence[Vector3]]
) -> dict[str, Array]:
    """Return the mean place of each tool's markers in the tracker frame, by names as `marker 1 of guide`."""
    known = _require_markers(frames, markers_mm)
    seen: dict[str, list[Array]] = {}
    for tool in (tool for frame in frames for tool in frame.tools):
        if tool.validity in POSED and tool.tool in known:
            pose = tool.transform(Frame.TRACKER, Frame.MARKER)
            for number, marker_mm in enumerate(known[tool.tool], 1):
                seen.setdefault(f"marker {number} of {tool.tool}", []).append(pose.apply(marker_mm))
    return {name: np.mean(places, axis=0) for name, places in seen.items()}


def _require_markers(
    frames: Sequence[TrackerFrame], markers_mm: Mapping[str, Sequence[Vector3]]
) -> dict[str, Array]:
    """Return the markers as arrays (n, 3). Raises ARG-001 for other shapes, tools and units."""
    expected = "for each tool its markers in mm, as tracker.markers_mm"
    if not isinstance(markers_mm, Mapping):
        raise WrongArgument("markers_mm is no mapping", expected=expected, got=show(markers_mm))
    tools = {tool.tool for frame in frames for tool in frame.tools}
    for name, places in markers_mm.items():
        if frames and name not in tools:
            raise WrongArgument(
                f"markers_mm names a tool that no frame has: {name!r}",
                expected=format_names(sorted(tools)) or "no tool",
                got=show(name),
            )
        found = require_numbers(places, f"the markers of {name}")
        if found.ndim != 2 or found.shape[1] != 3:
            raise WrongArgument(f"the markers of {name} have shape {found.shape}", expected="(n, 3)")
        if len(found) > 1 and float(np.ptp(found, axis=0).max()) < LEAST_TOOL_MM:
            raise WrongArgument(
                f"the markers of {name} lie within {float(np.ptp(found, axis=0).max()):g} mm",
                expected=f"at least {LEAST_TOOL_MM:g} mm apart",
                got=show(places),
                action="Give millimetres, not metres.",
            )
    return {name: np.asarray(places, dtype=float) for name, places in markers_mm.items()}


def identify_strays(
    frames: Iterable[Sequence[Vector3]], *, gate_mm: float = GATE_MM
) -> tuple[NDArray[np.int64], ...]:
    """Return the identity of each stray position (mm), frame by frame, or -1 where it cannot be told.

    Raises DEV-005.
    """
    if not 0.0 < gate_mm < math.inf:
        raise BAD_STRAYS("the gate must be positive", got=f"{gate_mm} mm")
    spheres: list[_Sphere] = []
    begun = 0
    found = []
    for frame in frames:
        readings = require_positions(frame)
        distances_mm = cdist(readings, _stack([one.last_mm for one in spheres]))
        pairs = pair_nearest(distances_mm, gate_mm)
        if _has_moved(spheres, pairs, len(readings)):
            spheres, pairs, distances_mm = [], {}, np.zeros((len(readings), 0))
        within = distances_mm <= gate_mm
        moved_mm = _stack([readings[row] - spheres[column].last_mm for row, column in pairs.items()])
        identities = np.full(len(readings), UNKNOWN, dtype=np.int64)
        here = []
        for row, reading in enumerate(readings):
            column = pairs.get(row)
            rivals = within[row].sum() if column is None else within[row].sum() + within[:, column].sum() - 2
            if rivals:
                here.append(_Sphere(reading, None))
                continue
            known = _NEW if column is None else spheres[column]
            if (identity := known.identity) is None:
                identity, begun = begun, begun + 1
            identities[row] = identity
            here.append(_Sphere(reading, identity, known.count + 1))
        unseen = [one for column, one in enumerate(spheres) if one.is_known and not within[:, column].any()]
        for one in unseen:
            one.in_last_frame = False
            if len(moved_mm):
                one.drift_mm = one.drift_mm + _typical(moved_mm)
        spheres = here + [one for one in unseen if float(np.linalg.norm(one.drift_mm)) <= gate_mm / 2.0]
        found.append(identities)
    return tuple(found)


def _has_moved(spheres: Sequence[_Sphere], pairs: Mapping[int, int], readings: int) -> bool:
    """Return whether the scene has moved since the last frame, or while it was hidden.

    Then known spheres are missing and as many new ones are there: of the last frame no fewer than have
    stayed, of all more than twice as many. One or two may be hidden spheres, and reflections that appear.
    """
    known = [column for column, one in enumerate(spheres) if one.is_known]
    seen = [column for column in known if spheres[column].in_last_frame]
    most = max(len(known) - 1, 1)  # of few spheres one may have stayed by chance: it is now where another was
    stayed, missing = _count_missing(seen, pairs, readings)
    if missing >= max(stayed, min(FEWEST_MOVED, most)):
        return True
    stayed, missing = _count_missing(known, pairs, readings)
    return missing >= max(2 * stayed + 1, min(FEWEST_MOVED_UNSEEN, most))


def _count_missing(columns: Sequence[int], pairs: Mapping[int, int], readings: int) -> tuple[int, int]:
    """Return how many spheres have stayed, and how many are missing that may be among the new readings."""
    stayed = len(set(columns).intersection(pairs.values()))
    return stayed, min(len(columns) - stayed, readings - len(pairs))


def _typical(moved_mm: Array) -> Array:
    """Return the movement of median length; of two the shorter, as a reflection wanders by itself."""
    return np.asarray(moved_mm[np.argsort(np.linalg.norm(moved_mm, axis=1))[(len(moved_mm) - 1) // 2]])


def _stack(vectors: Sequence[Array]) -> Array:
    return np.array(vectors, dtype=float).reshape(-1, 3)
