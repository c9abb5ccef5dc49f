"""The two-way table of a registration as it stands in records."""

from __future__ import annotations

from dataclasses import asdict

from pydantic import Field

from procedures.engine.result import Values
from procedures.registration.verification import Instrument, VerificationTable


class CtToRoomRow(Values):
    """One sphere of the CT and what the room says about it; none where nothing was measured."""

    fiducial: int = Field(description="Index in the CT.")
    ct_disagreement_mm: float | None = Field(description="Between the two estimates of its centre.")
    tracker_index: int | None = Field(description="Its partner among the tracker's points.")
    tracker_residual_mm: float | None = Field(description="Distance to that partner.")
    stereo_residual_mm: float | None = Field(description="Distance to the stereo head's point.")
    leave_one_out_mm: float | None = Field(description="The same, registered without it.")
    partner_is_nearest: bool | None = Field(description="Whether no other point of the tracker is nearer.")


class RoomToCtRow(Values):
    """One measured point, mapped into the CT."""

    instrument: Instrument = Field(description="Tracker or stereo head.")
    index: int = Field(description="Among that instrument's points.")
    fiducial: int | None = Field(description="Its partner in the CT; none when unmatched.")
    nearest_fiducial: int = Field(description="The nearest sphere of the CT.")
    distance_mm: float = Field(description="To that sphere.")


class TwoWayTable(Values):
    """Both directions, with what is unmatched on either side."""

    ct_to_room: tuple[CtToRoomRow, ...] = Field(description="A row for each sphere of the CT.")
    room_to_ct: tuple[RoomToCtRow, ...] = Field(description="A row for each measured point.")
    unmatched_ct: tuple[int, ...] = Field(description="Spheres of the CT that nothing in the room confirms.")
    unmatched_room: tuple[tuple[Instrument, int], ...] = Field(description="Points that no sphere is.")
    agrees_both_ways: bool = Field(description="Every partner is the nearest in both directions.")

    @classmethod
    def of(cls, table: VerificationTable) -> TwoWayTable:
        """The numerics' table as plain numbers."""
        return cls(
            ct_to_room=tuple(CtToRoomRow(**asdict(row)) for row in table.ct_to_room),
            room_to_ct=tuple(RoomToCtRow(**asdict(row)) for row in table.room_to_ct),
            unmatched_ct=table.unmatched_ct,
            unmatched_room=table.unmatched_room,
            agrees_both_ways=table.agrees_both_ways,
        )
