"""The measuring volumes as described by the unit, and the clearance of a point."""

from __future__ import annotations

import re
from dataclasses import dataclass

from conformance.case import check
from conformance.polaris.bx_reply import Vector3
from conformance.polaris.link import PolarisLink
from ronna_hw.wire.polaris import PARAMETER_SELECTED_VOLUME, SFLIST_VOLUME_CHARACTERS

_RECORD = re.compile(r"([0-9A-F])((?:[+-][0-9]{6}){10}).*", re.DOTALL)
# As described by two real units: far, knee and near z, half extents y and x at the knee, slopes of |y| in
# front of and behind it, of |x|, caps of |y| and |x|.
SPECTRA_VOLUMES = (
    (-240000, -153200, -95000, 57200, 39800, 56946, 24303, 29773, 999999, 999999),
    (-300000, -153200, -95000, 57200, 39800, 56946, 24303, 29773, 999999, 73500),
)
SPECTRA_SHAPE, VICRA_SHAPE = "5", "7"


@dataclass(frozen=True)
class MeasuringVolume:
    """One volume: its shape and its ten numbers, in hundredths of a mm and of a slope per 1000."""

    shape: str
    numbers: tuple[int, ...]

    @property
    def knee_mm(self) -> float:
        """Depth z at which the slope of |y| changes."""
        return self.numbers[1] / 100

    @property
    def depths_mm(self) -> tuple[float, float]:
        """z of the far and of the near face."""
        return self.numbers[0] / 100, self.numbers[2] / 100

    @property
    def middle_mm(self) -> float:
        """A depth z well inside: that of the knee, or the midpoint if the knee is at a face."""
        far_mm, near_mm = self.depths_mm
        return self.knee_mm if far_mm < self.knee_mm < near_mm else (far_mm + near_mm) / 2

    def half_extents_mm(self, z_mm: float) -> tuple[float, float]:
        """Largest |x| and |y| inside at a depth."""
        _, knee, _, y_knee, x_knee, y_front, y_behind, x_slope, y_cap, x_cap = self.numbers
        behind_mm = knee / 100 - z_mm  # negative in front of the knee
        y_mm = y_knee / 100 + behind_mm * (y_behind if behind_mm > 0 else y_front) / 1e5
        x_mm = x_knee / 100 + behind_mm * x_slope / 1e5
        return min(x_mm, x_cap / 100), min(y_mm, y_cap / 100)

    def clearance_mm(self, point_mm: Vector3) -> float:
        """How far inside a point is, along the closest axis; negative outside."""
        x, y, z = point_mm
        far_mm, near_mm = self.depths_mm
        x_mm, y_mm = self.half_extents_mm(z)
        return min(x_mm - abs(x), y_mm - abs(y), z - far_mm, near_mm - z)


def measuring_volumes(unit: PolarisLink) -> tuple[MeasuringVolume, ...]:
    """The volumes by SFLIST 03; every record must have its exact length."""
    text = unit.ask("SFLIST:03")
    records = text[1:].splitlines(keepends=True)
    check(text[:1].isdigit() and int(text[:1]) == len(records), "as many volumes as announced", text[:1])
    volumes = []
    for record in records:
        check(len(record) == SFLIST_VOLUME_CHARACTERS, "74 characters with the line feed", len(record))
        match = _RECORD.fullmatch(record)
        check(match is not None, "a shape and ten numbers", record)
        assert match is not None
        numbers = tuple(int(match[2][at : at + 7]) for at in range(0, 70, 7))
        volumes.append(MeasuringVolume(match[1], numbers))
    return tuple(volumes)


def volume_in_use(unit: PolarisLink) -> MeasuringVolume:
    """The selected volume; the first if the unit does not report it."""
    volumes = measuring_volumes(unit)
    value = unit.ask(f"GET:{PARAMETER_SELECTED_VOLUME}").partition("=")[2].strip()
    return volumes[int(value)] if value.isdecimal() and int(value) < len(volumes) else volumes[0]
