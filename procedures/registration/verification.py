"""Two-way verification of a registration: CT -> room and room -> CT, one row per fiducial and per reading.

Every fiducial of the CT is looked for in the room and every reading of the room in the CT, each with the
evidence that its own instruments give: agreement of the two CT estimators, tracker residual, stereo
residual, leave-one-out residual, and whether its nearest neighbour on the other side is its partner.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from procedures.registration.errors import BadPoints
from procedures.registration.point_registration import Registration
from procedures.registration.points import checked_points

Array = NDArray[np.float64]


class Instrument(StrEnum):
    """What measured a point in the room."""

    TRACKER = "tracker"
    STEREO = "stereo"


@dataclass(frozen=True)
class CtToRoom:
    """One fiducial of the CT and what the room says about it; None where nothing was measured, in mm.

    `partner_is_nearest` tells whether, mapped into the room, the tracker reading nearest to the fiducial is
    the one it was paired with.
    """

    fiducial: int
    ct_disagreement_mm: float | None
    tracker_index: int | None
    tracker_residual_mm: float | None
    stereo_residual_mm: float | None
    leave_one_out_mm: float | None
    partner_is_nearest: bool | None

    @property
    def unmatched(self) -> bool:
        """In the CT, but neither the tracker nor the stereo head has it."""
        return self.tracker_index is None and self.stereo_residual_mm is None


@dataclass(frozen=True)
class RoomToCt:
    """One reading of the room, mapped into the CT. `fiducial` is its partner, None when unmatched."""

    instrument: Instrument
    index: int
    fiducial: int | None
    nearest_fiducial: int
    distance_mm: float

    @property
    def unmatched(self) -> bool:
        """In the room, but no fiducial of the CT is its partner."""
        return self.fiducial is None

    @property
    def partner_is_nearest(self) -> bool:
        """Whether the nearest fiducial in the CT is the partner."""
        return self.fiducial == self.nearest_fiducial


@dataclass(frozen=True)
class RoomPoint:
    """A stereo measurement of one known fiducial, in the frame that the fine transform maps to, mm."""

    fiducial: int
    position_mm: tuple[float, float, float]


@dataclass(frozen=True)
class VerificationTable:
    """Both directions, with what is unmatched on either side."""

    ct_to_room: tuple[CtToRoom, ...]
    room_to_ct: tuple[RoomToCt, ...]

    @property
    def unmatched_ct(self) -> tuple[int, ...]:
        """Fiducials of the CT that nothing in the room confirms."""
        return tuple(row.fiducial for row in self.ct_to_room if row.unmatched)

    @property
    def unmatched_room(self) -> tuple[tuple[Instrument, int], ...]:
        """Readings of the room that are no fiducial of the CT."""
        return tuple((row.instrument, row.index) for row in self.room_to_ct if row.unmatched)

    @property
    def agrees_both_ways(self) -> bool:
        """Every pair is its partner's nearest neighbour in both directions."""
        forward = all(row.partner_is_nearest is not False for row in self.ct_to_room)
        return forward and all(row.partner_is_nearest for row in self.room_to_ct if not row.unmatched)


def verify_two_way(
    image_mm: ArrayLike,
    tracker_mm: ArrayLike,
    pairs: ArrayLike,
    coarse: RigidTransform,
    *,
    fine: Registration | None = None,
    stereo: Sequence[RoomPoint] = (),
    ct_disagreement_mm: Mapping[int, float] | None = None,
) -> VerificationTable:
    """Build the table.

    `image_mm` (n, 3) are all fiducials of the CT, `tracker_mm` (m, 3) all stray readings averaged, `pairs`
    (k, 2) their correspondence with `coarse` tracker <- CT. `stereo` are the fine measurements in the order
    in which `fine` was registered from them. `ct_disagreement_mm` gives, by fiducial, the distance between
    the two CT estimators. Raises REG-001.
    """
    image, tracker = checked_points(image_mm, "image"), checked_points(tracker_mm, "tracker")
    partners = np.asarray(pairs, dtype=int).reshape(-1, 2)
    if len(partners) and (
        partners.min() < 0 or np.any(partners.max(axis=0) >= np.array([len(image), len(tracker)]))
    ):
        raise BadPoints("a pair names a point that does not exist")
    if any(not 0 <= point.fiducial < len(image) for point in stereo):
        raise BadPoints("a stereo measurement names a fiducial that does not exist")
    if fine is not None and fine.pairs != len(stereo):
        raise BadPoints(f"{fine.pairs} registered pairs but {len(stereo)} stereo measurements")
    rows = _ct_to_room(image, tracker, partners, coarse, fine, stereo, ct_disagreement_mm or {})
    readings = [
        (Instrument.TRACKER, index, _partner_of(index, partners), point, coarse)
        for index, point in enumerate(tracker)
    ]
    if fine is not None:
        readings += [
            (Instrument.STEREO, index, point.fiducial, np.asarray(point.position_mm), fine.transform)
            for index, point in enumerate(stereo)
        ]
    return VerificationTable(
        rows, tuple(_room_to_ct(image, *reading) for reading in readings) if len(image) else ()
    )


def _ct_to_room(
    image: Array,
    tracker: Array,
    partners: NDArray[np.int_],
    coarse: RigidTransform,
    fine: Registration | None,
    stereo: Sequence[RoomPoint],
    disagreement: Mapping[int, float],
) -> tuple[CtToRoom, ...]:
    tracker_of = {int(fiducial): int(reading) for fiducial, reading in partners}
    mapped = np.asarray(coarse.apply(image), dtype=float) if len(image) else image
    measured = {point.fiducial: row for row, point in enumerate(stereo)} if fine is not None else {}
    rows = []
    for fiducial in range(len(image)):
        reading = tracker_of.get(fiducial)
        distances = np.linalg.norm(tracker - mapped[fiducial], axis=1)
        row = measured.get(fiducial)
        rows.append(
            CtToRoom(
                fiducial,
                disagreement.get(fiducial),
                reading,
                None if reading is None else float(distances[reading]),
                None if row is None or fine is None else float(np.linalg.norm(fine.residuals_mm[row])),
                None if row is None or fine is None else fine.leave_one_out_mm[row],
                None if reading is None else int(distances.argmin()) == reading,
            )
        )
    return tuple(rows)


def _partner_of(reading: int, partners: NDArray[np.int_]) -> int | None:
    rows = np.flatnonzero(partners[:, 1] == reading)
    return int(partners[rows[0], 0]) if len(rows) else None


def _room_to_ct(
    image: Array,
    instrument: Instrument,
    index: int,
    fiducial: int | None,
    position: Array,
    room_from_ct: RigidTransform,
) -> RoomToCt:
    back = np.asarray(room_from_ct.inv().apply(position), dtype=float)
    distances = np.linalg.norm(image - back, axis=1)
    nearest = int(distances.argmin())
    shown = nearest if fiducial is None else fiducial
    return RoomToCt(instrument, index, fiducial, nearest, float(distances[shown]))
