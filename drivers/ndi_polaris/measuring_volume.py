"""Measuring volume as reported by the unit, or as published for its model."""

from __future__ import annotations

import re
from dataclasses import dataclass
from types import MappingProxyType

from drivers.ndi_polaris.command_link import CommandLink
from drivers.ndi_polaris.errors import MalformedReply, UnitError
from drivers.ndi_polaris.unit import names_model, parse_whole_number, read_parameter_or
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.devices.sensors import VolumeSections
from ronna_hw.vectors import Vector3
from ronna_hw.wire import polaris as ndi
from ronna_hw.wire.polaris import PolarisModel

PYRAMID_SHAPE = "5"  # pyramid and extended pyramid of the Spectra: the only shape whose formula is public
SLOPE_PER = 1000.0  # slopes are sent per 1000
SFLIST_BYTES = 1024  # room for nine volumes of 74 characters each
_DIMENSION = re.compile(rf"[+-][0-9]{{{ndi.SFLIST_DIMENSION_CHARACTERS - 1}}}")


@dataclass(frozen=True)
class MeasuringVolume:
    """Measuring volume in tracker coordinates, mm: a truncated pyramid with a knee, at negative z."""

    shape: str
    far_z_mm: float  # D1
    knee_z_mm: float  # D2
    near_z_mm: float  # D3
    knee_half_y_mm: float  # D4
    knee_half_x_mm: float  # D5
    slope_y_front: float  # D6: growth of half y per mm of depth, in front of the knee
    slope_y_behind: float  # D7
    slope_x: float  # D8, on both sides
    cap_y_mm: float  # D9
    cap_x_mm: float  # D10

    def contains(self, position_mm: Vector3) -> bool | None:
        """Return whether a position is inside, or None for an unknown volume shape."""
        if self.shape != PYRAMID_SHAPE:
            return None
        x, y, z = position_mm
        if not self.far_z_mm <= z <= self.near_z_mm:
            return False
        half_x, half_y = self._half_extents_mm(z)
        return abs(x) <= half_x and abs(y) <= half_y

    @property
    def sections_mm(self) -> VolumeSections:
        """Cross-sections at the bends, near to far, as (z, half x, half y); empty for unknown shapes."""
        if self.shape != PYRAMID_SHAPE:
            return ()
        depths_mm = [self.near_z_mm, self.knee_z_mm, self.far_z_mm]
        if self.slope_x > 0.0:
            depths_mm.append(self.knee_z_mm - (self.cap_x_mm - self.knee_half_x_mm) / self.slope_x)
        bends_mm = sorted({z for z in depths_mm if self.far_z_mm <= z <= self.near_z_mm}, reverse=True)
        return tuple((z, *self._half_extents_mm(z)) for z in bends_mm)

    def _half_extents_mm(self, z_mm: float) -> tuple[float, float]:
        """Return the half extents along x and y at a depth, mm."""
        behind_knee_mm = self.knee_z_mm - z_mm
        slope_y = self.slope_y_behind if behind_knee_mm > 0 else self.slope_y_front
        half_y = min(self.knee_half_y_mm + behind_knee_mm * slope_y, self.cap_y_mm)
        return min(self.knee_half_x_mm + behind_knee_mm * self.slope_x, self.cap_x_mm), half_y


def parse_volumes(text: str) -> tuple[MeasuringVolume, ...]:
    """Parse an SFLIST 03 reply: a one-digit count, then one record per volume; raises NDI-006."""
    count, records = text[:1], text[1:].strip(ndi.LF).split(ndi.LF)
    if not count.isdecimal() or int(count) != len(records):
        raise MalformedReply(f"SFLIST announces {count or 'no'} volumes but sends {len(records)}")
    return tuple(_parse_volume(record) for record in records)


def _parse_volume(record: str) -> MeasuringVolume:
    width = ndi.SFLIST_DIMENSION_CHARACTERS
    fields = [record[at : at + width] for at in range(1, 1 + width * ndi.SFLIST_DIMENSIONS, width)]
    if not all(_DIMENSION.fullmatch(field) for field in fields):
        raise MalformedReply("unknown form of a volume in SFLIST", wire=record.encode("ascii", "replace"))
    numbers = [int(field) / ndi.SFLIST_DIMENSION_SCALE for field in fields]
    slopes = (number / SLOPE_PER for number in numbers[5:8])
    return MeasuringVolume(record[0], *numbers[:5], *slopes, *numbers[8:])


_PYRAMID = _parse_volume("5-240000-153200-095000+057200+039800+056946+024303+029773+999999+999999")
# As real Spectras send it. Public programs for the Vega test against the same; the Vicra's ten numbers are
# not public, and those of this pyramid from 0.56 to 1.34 m are unconfirmed (U).
PUBLISHED_VOLUMES = MappingProxyType(
    {
        PolarisModel.SPECTRA: _PYRAMID,
        PolarisModel.VICRA: _parse_volume(
            "5-133600-055700-055700+024550+019600+028690+028690+031772+999999+999999"
        ),
        PolarisModel.VEGA: _PYRAMID,
    }
)


def choose_volume(link: CommandLink, wanted: int | None) -> MeasuringVolume | None:
    """Select volume `wanted` (from 1), if given, and return the volume in use, or None if unknown."""
    if wanted is not None:
        link.ask("VSEL", f"{wanted}")
    try:
        volumes = parse_volumes(link.ask("SFLIST", ndi.SFLIST_VOLUMES, reply_bytes=SFLIST_BYTES))
    except (UnitError, MalformedReply):
        return None
    if wanted is not None:
        index = wanted - 1
    else:
        index = parse_whole_number(read_parameter_or(link, ndi.PARAMETER_SELECTED_VOLUME, "")) or 0
    return volumes[index] if 0 <= index < len(volumes) else None


def find_published_volume(unit: Identity | None, expected: PolarisModel | None) -> MeasuringVolume | None:
    """Return the published volume of a unit's model, or None for an unknown model.

    A unit that is not connected yet is taken for the expected model, or else for a Spectra.
    """
    if unit is None:
        return PUBLISHED_VOLUMES[expected or PolarisModel.SPECTRA]
    return next((volume for model, volume in PUBLISHED_VOLUMES.items() if names_model(unit, model)), None)
