"""Two-way verification of a registration, CT -> room and room -> CT, by fiducial and by reading.

Every fiducial of the CT is looked up in the room and every reading of the room in the CT, each with its own
evidence: agreement of the two CT estimators, tracker residual, stereo residual, leave-one-out residual, and
whether its nearest neighbour on the other side is its partner.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field
from scipy.spatial.transform import RigidTransform

from procedures.registration.errors import BAD_POINTS
from procedures.registration.point_registration import Registration
from procedures.registration.points import validate_points, validate_transform
from ronna_hw.arrays import Array
from ronna_hw.calibration import Strict
from ronna_hw.frames import Transform


class MeasuringInstrument(StrEnum):
    """Instrument that measured a point in the room."""

    TRACKER = "tracker"
    STEREO = "stereo"


class CtToRoomRow(Strict):
    """CT sphere and its measurements in the room; None where it was not measured."""

    fiducial: int = Field(description="Index in the CT.")
    ct_disagreement_mm: float | None = Field(description="Distance between the two estimates of its centre.")
    tracker_index: int | None = Field(description="Its match among the tracker's points.")
    tracker_residual_mm: float | None = Field(description="Distance to that match.")
    stereo_residual_mm: float | None = Field(description="Distance to the stereo head's point.")
    leave_one_out_mm: float | None = Field(description="The same, registered without it.")
    partner_is_nearest: bool | None = Field(description="Whether no other point of the tracker is nearer.")


class RoomToCtRow(Strict):
    """Measured point, mapped into the CT."""

    instrument: MeasuringInstrument = Field(description="Tracker or stereo head.")
    index: int = Field(description="Among that instrument's points.")
    fiducial: int | None = Field(description="Its match in the CT; none if unmatched.")
    nearest_fiducial: int = Field(description="The nearest sphere of the CT.")
    distance_mm: float = Field(description="Distance to that sphere.")


class TwoWayTable(Strict):
    """Table for both directions, with the unmatched points on either side."""

    ct_to_room: tuple[CtToRoomRow, ...] = Field(description="A row for each sphere of the CT.")
    room_to_ct: tuple[RoomToCtRow, ...] = Field(description="A row for each measured point.")
    unmatched_ct: tuple[int, ...] = Field(description="Spheres of the CT without a match in the room.")
    unmatched_room: tuple[tuple[MeasuringInstrument, int], ...] = Field(
        description="Points that match no sphere."
    )
    agrees_both_ways: bool = Field(description="Every match is the nearest in both directions.")

    def beside_skin(self, residuals_mm: Mapping[int, float], without_mm: Mapping[int, float]) -> Self:
        """Return the table with what the stereo head measured at spheres (of the CT) beside the skin.

        They were registered together with the skin; `without_mm` is how far that has each by all the others.
        """
        rows = (
            row.model_copy(
                update={
                    "stereo_residual_mm": residuals_mm.get(row.fiducial),
                    "leave_one_out_mm": without_mm.get(row.fiducial),
                }
            )
            for row in self.ct_to_room
        )
        unmatched = tuple(one for one in self.unmatched_ct if one not in residuals_mm)
        return self.model_copy(update={"ct_to_room": tuple(rows), "unmatched_ct": unmatched})


@dataclass(frozen=True)
class RoomPoint:
    """Stereo measurement of a known fiducial, in the target frame of the fine transform, mm."""

    fiducial: int
    position_mm: tuple[float, float, float]


def verify_two_way(
    image_mm: ArrayLike,
    tracker_mm: ArrayLike,
    pairs: ArrayLike,
    coarse: RigidTransform | Transform | ArrayLike,
    *,
    fine: Registration | None = None,
    stereo: Sequence[RoomPoint] = (),
    ct_disagreement_mm: Mapping[int, float] | None = None,
) -> TwoWayTable:
    """Build the two-way table.

    `image_mm` (n, 3) are all fiducials of the CT, `tracker_mm` (m, 3) all averaged stray markers, `pairs` (k,
    2) their correspondence with `coarse` tracker <- CT, also as a matrix (4, 4) in mm. `stereo` are the fine
    measurements in the order in which `fine` was registered from them. `ct_disagreement_mm` is, per fiducial,
    the distance between the two CT estimators. Raises REG-001, 007.
    """
    image, tracker = validate_points(image_mm, "image"), validate_points(tracker_mm, "tracker")
    tracker_from_ct = validate_transform(coarse, "coarse registration")
    partners = np.asarray(pairs, dtype=int).reshape(-1, 2)
    if len(partners) and (
        partners.min() < 0 or np.any(partners.max(axis=0) >= np.array([len(image), len(tracker)]))
    ):
        raise BAD_POINTS("a pair names a point that does not exist")
    if any(not 0 <= point.fiducial < len(image) for point in stereo):
        raise BAD_POINTS("a stereo measurement names a fiducial that does not exist")
    if fine is not None and fine.pairs != len(stereo):
        raise BAD_POINTS(f"{fine.pairs} registered pairs but {len(stereo)} stereo measurements")
    rows = _build_ct_rows(image, tracker, partners, tracker_from_ct, fine, stereo, ct_disagreement_mm or {})
    fiducial_of = {reading: fiducial for fiducial, reading in reversed(partners.tolist())}
    readings = [
        (MeasuringInstrument.TRACKER, index, fiducial_of.get(index), point, tracker_from_ct)
        for index, point in enumerate(tracker)
    ]
    if fine is not None:
        readings += [
            (MeasuringInstrument.STEREO, index, point.fiducial, np.asarray(point.position_mm), fine.transform)
            for index, point in enumerate(stereo)
        ]
    back = tuple(_build_room_row(image, *reading) for reading in readings) if len(image) else ()
    forward_agrees = all(row.partner_is_nearest is not False for row in rows)
    return TwoWayTable(
        ct_to_room=rows,
        room_to_ct=back,
        unmatched_ct=tuple(
            row.fiducial for row in rows if row.tracker_index is None and row.stereo_residual_mm is None
        ),
        unmatched_room=tuple((row.instrument, row.index) for row in back if row.fiducial is None),
        agrees_both_ways=forward_agrees and all(row.fiducial in (None, row.nearest_fiducial) for row in back),
    )


def _build_ct_rows(
    image: Array,
    tracker: Array,
    partners: NDArray[np.int_],
    coarse: RigidTransform,
    fine: Registration | None,
    stereo: Sequence[RoomPoint],
    disagreement: Mapping[int, float],
) -> tuple[CtToRoomRow, ...]:
    tracker_of = {int(fiducial): int(reading) for fiducial, reading in partners}
    mapped = np.asarray(coarse.apply(image), dtype=float) if len(image) else image
    measured = {point.fiducial: row for row, point in enumerate(stereo)} if fine is not None else {}
    rows = []
    for fiducial in range(len(image)):
        reading, row = tracker_of.get(fiducial), measured.get(fiducial)
        distances = np.linalg.norm(tracker - mapped[fiducial], axis=1)
        rows.append(
            CtToRoomRow(
                fiducial=fiducial,
                ct_disagreement_mm=disagreement.get(fiducial),
                tracker_index=reading,
                tracker_residual_mm=None if reading is None else float(distances[reading]),
                stereo_residual_mm=None
                if row is None or fine is None
                else float(np.linalg.norm(fine.residuals_mm[row])),
                leave_one_out_mm=None if row is None or fine is None else fine.leave_one_out_mm[row],
                partner_is_nearest=None if reading is None else int(distances.argmin()) == reading,
            )
        )
    return tuple(rows)


def _build_room_row(
    image: Array,
    instrument: MeasuringInstrument,
    index: int,
    fiducial: int | None,
    position: Array,
    room_from_ct: RigidTransform,
) -> RoomToCtRow:
    back = np.asarray(room_from_ct.inv().apply(position), dtype=float)
    distances = np.linalg.norm(image - back, axis=1)
    nearest = int(distances.argmin())
    return RoomToCtRow(
        instrument=instrument,
        index=index,
        fiducial=fiducial,
        nearest_fiducial=nearest,
        distance_mm=float(distances[nearest if fiducial is None else fiducial]),
    )
