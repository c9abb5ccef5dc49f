"""Unit models: identity, ports, limits and measuring volumes, with invented serial numbers.

Tracker frame: origin at the sensor, z backwards, so everything in view has negative z. A volume is a pyramid
with a knee, given by the ten numbers of the feature list (SFLIST 03) in its own units: lengths in 1/100 mm,
slopes in 1/100 000.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType

from ronna_hw.wire.polaris import LF, SFLIST_DIMENSION_SCALE, PolarisModel

SLOPE_SCALE = 100_000  # slopes are given per 1000 mm, in hundredths
NO_CAP = 999_999
WAVELENGTHS = "24"  # as sent by real Spectras; the meaning of its two digits is not public


@dataclass(frozen=True)
class UnitVolume:
    """Measuring volume: shape code, the ten parameters D1..D10, and the accuracy that is stated for it."""

    name: str
    shape: str
    dimensions: tuple[int, int, int, int, int, int, int, int, int, int]
    stated_mm: float  # 3-D rms of one marker

    def holds(self, x_mm: float, y_mm: float, z_mm: float) -> bool:
        """Return whether a point in the tracker frame is inside the volume."""
        near_mm, far_mm = self.depths_mm
        if not near_mm <= -z_mm <= far_mm:
            return False
        x_half_mm, y_half_mm = self.half_widths_mm(-z_mm)
        return abs(y_mm) <= y_half_mm and abs(x_mm) <= x_half_mm

    @cached_property
    def depths_mm(self) -> tuple[float, float]:
        """Nearest and farthest distances from the sensor along its axis."""
        far, _, near, *_ = self.dimensions
        return -near / SFLIST_DIMENSION_SCALE, -far / SFLIST_DIMENSION_SCALE

    @property
    def middle_depth_mm(self) -> float:
        """Mean of the nearest and farthest distances."""
        return sum(self.depths_mm) / 2.0

    def half_widths_mm(self, depth_mm: float) -> tuple[float, float]:
        """Return the half extents in x and y at a distance from the sensor."""
        _, _, _, _, _, y_front, y_behind, x_slope, _, _ = self.dimensions
        knee_mm, y_knee_mm, x_knee_mm, y_cap_mm, x_cap_mm = self._lengths_mm
        before_knee_mm = -depth_mm - knee_mm
        y_slope = y_front if before_knee_mm >= 0.0 else y_behind
        y_half_mm = y_knee_mm - before_knee_mm * y_slope / SLOPE_SCALE
        x_half_mm = x_knee_mm - before_knee_mm * x_slope / SLOPE_SCALE
        return min(x_half_mm, x_cap_mm), min(y_half_mm, y_cap_mm)

    @cached_property
    def _lengths_mm(self) -> tuple[float, float, float, float, float]:
        """Distance of the knee, half extents there in y and x, and largest half extents in y and x, in mm."""
        _, knee, _, y_knee, x_knee, _, _, _, y_cap, x_cap = self.dimensions
        scale = SFLIST_DIMENSION_SCALE
        return knee / scale, y_knee / scale, x_knee / scale, y_cap / scale, x_cap / scale

    def feature_line(self) -> str:
        """Return the volume's feature list record: 74 characters ending in a line feed."""
        numbers = "".join(f"{value:+07d}" for value in self.dimensions)
        return f"{self.shape}{numbers}{WAVELENGTHS}{LF}"


PYRAMID = UnitVolume(
    name="Pyramid",
    shape="5",
    dimensions=(-240000, -153200, -95000, 57200, 39800, 56946, 24303, 29773, NO_CAP, NO_CAP),
    stated_mm=0.25,
)
EXTENDED_PYRAMID = UnitVolume(
    name="Extended Pyramid",
    shape="5",
    dimensions=(-300000, -153200, -95000, 57200, 39800, 56946, 24303, 29773, NO_CAP, 73500),
    stated_mm=0.30,
)
# About 491 x 392 mm at 557 mm and 938 x 887 mm at 1336 mm; the ten numbers themselves are not public.
VICRA_VOLUME = UnitVolume(
    name="Vicra",
    shape="7",
    dimensions=(-133600, -55700, -55700, 24550, 19600, 28690, 28690, 31772, NO_CAP, NO_CAP),
    stated_mm=0.25,
)


@dataclass(frozen=True)
class UnitModel:
    """A model of the unit."""

    name: str
    serial_number: str
    firmware: str  # major.minor.build
    combined_revision: str
    package: str
    api_revision: str
    characterization_date: str  # MM/DD/YY
    freeze_date: str
    volumes: tuple[UnitVolume, ...]
    handles: int
    enabled_tools: int
    wired_ports: int  # of the optional tool interface; 0 if the model has none
    passive_ports: int
    wireless_ports: int
    baud_codes: str
    illuminator_rates: tuple[int, ...]  # codes of IRATE
    longest_command: int
    networked: bool = False  # reached by TCP instead of a serial line


SPECTRA = UnitModel(
    name="Polaris Spectra",
    serial_number="P7-00042",
    firmware="007.000.012",
    combined_revision="024",
    package="024.002",
    api_revision="G.001.005",
    characterization_date="06/05/24",
    freeze_date="01/04/10",
    volumes=(PYRAMID, EXTENDED_PYRAMID),
    handles=24,
    enabled_tools=15,
    wired_ports=3,
    passive_ports=9,
    wireless_ports=1,
    baud_codes="01234567A",
    illuminator_rates=(0, 1, 2),
    longest_command=1024,
)
VICRA = replace(
    SPECTRA,
    name="Polaris Vicra",
    serial_number="P6-00042",
    firmware="007.000.011",
    combined_revision="014",
    package="014.002",
    volumes=(VICRA_VOLUME,),
    enabled_tools=6,
    wired_ports=0,
    passive_ports=6,
    illuminator_rates=(0,),
)
# Public programs for the Vega test against the pyramid of the Spectra, from 0.95 to 2.4 m. Its extended
# pyramid, accuracy, 60 Hz and revisions are unconfirmed (U); ports and limits are a Spectra's (U).
VEGA = replace(
    SPECTRA,
    name="Polaris Vega ST",
    serial_number="P9-00042",
    firmware="002.000.012",
    api_revision="G.002.005",
    volumes=(replace(PYRAMID, stated_mm=0.12), replace(EXTENDED_PYRAMID, stated_mm=0.15)),
    wired_ports=0,
    networked=True,
)
UNIT_MODELS: MappingProxyType[PolarisModel, UnitModel] = MappingProxyType(
    {PolarisModel.SPECTRA: SPECTRA, PolarisModel.VICRA: VICRA, PolarisModel.VEGA: VEGA}
)
