"""Plane and width of the laser light in the tool frame: fitted to scanned lines, recorded, compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import AwareDatetime, Field

from procedures.relocalization.errors import LINE_MOVED, LINE_PLANE_UNKNOWN
from ronna_hw.arrays import Array
from ronna_hw.calibration import Numbers3, Strict
from ronna_hw.robust_scale import robust_sigma

LARGEST_SHIFT_MM = 0.1  # of the plane at the tool centre point; a line is about 0.2 mm wide
LARGEST_TURN_RAD = 0.005  # 0.1 mm at the ends of a line of 24 mm, twice over
LARGEST_WIDENING = 0.3  # relative
OUTLIER_SIGMAS = 4.0
# Of the points within the plane, across the lines: one line, and lines at one distance, leave its turn open.
# Safety against a record that later blames a sound projector. Source: three distances, 5 mm apart, have 4 mm.
LEAST_SPREAD_MM = 2.0


@dataclass(frozen=True)
class LightPlane:
    """Plane in the tool frame: unit normal (3,) and distance from the origin along it, mm.

    `rms_mm` is the scatter of the points about it, `spread_mm` (2,) their standard deviations within it, the
    larger first: where the smaller is next to nothing, the plane may turn about the line.
    """

    normal: Array
    offset_mm: float
    rms_mm: float
    spread_mm: tuple[float, float]

    def distance_mm(self, points_mm: Array) -> Array:
        """Return signed distances (n,) of points (n, 3)."""
        return np.asarray(points_mm @ self.normal - self.offset_mm)

    def deviation_mm(self, covariance_mm2: Array) -> Array:
        """Return the standard deviations (n,) of these distances, from covariances (n, 3, 3)."""
        variance = np.einsum("i,nij,j->n", self.normal, covariance_mm2, self.normal)
        return np.asarray(np.sqrt(variance), dtype=float)


class LineRecord(Strict):
    """Plane of the light in the tool frame and width of the line, as recorded."""

    normal: Numbers3 = Field(description="Unit normal of the plane.")
    offset_mm: float = Field(description="Distance of the plane from the tool centre point along it.")
    rms_mm: Annotated[float, Field(ge=0)] = Field(description="Scatter of the points about the plane.")
    spread_mm: tuple[float, float] = Field(description="Standard deviations of the points within the plane.")
    width_mm: Annotated[float, Field(gt=0)] = Field(
        description="Width of the line at its points, one standard deviation of its profile."
    )
    lines: Annotated[int, Field(ge=1)] = Field(description="Number of lines.")
    created: AwareDatetime | None = Field(
        default=None, description="Time of the record; none in one written before records had it."
    )
    stereo_head: str = Field(default="", description="Calibration of the stereo head that measured it.")
    camera_serials: tuple[str, ...] = Field(
        default=(), description="Serial numbers of its cameras, the left one first."
    )

    @property
    def origin(self) -> str:
        """Date, calibration and cameras in words."""
        when = "without a date" if self.created is None else f"of {self.created:%Y-%m-%d}"
        cameras = f", cameras {' and '.join(self.camera_serials)}" if self.camera_serials else ""
        return f"{when}, stereo head {self.stereo_head or 'not named'}{cameras}"

    @property
    def plane(self) -> LightPlane:
        """Plane in computational form."""
        return LightPlane(np.array(self.normal), self.offset_mm, self.rms_mm, self.spread_mm)

    def compare(self, other: LineRecord) -> tuple[float, float, float]:
        """Return shift at the tool centre point in mm, turn in rad, and widening of another record."""
        along = float(np.clip(np.dot(self.normal, other.normal), -1.0, 1.0))
        shift = (other.offset_mm if along >= 0.0 else -other.offset_mm) - self.offset_mm
        return shift, float(np.arccos(abs(along))), other.width_mm / self.width_mm - 1.0

    def require_same(self, other: LineRecord) -> None:
        """Raise STE-018 unless another record is the same within its limits."""
        shift, turn, widening = self.compare(other)
        words = (
            (abs(shift), LARGEST_SHIFT_MM, "its plane has shifted at the tool centre point", "{:.3f} mm"),
            (turn, LARGEST_TURN_RAD, "its plane has turned", "{:.4f} rad"),
            (abs(widening), LARGEST_WIDENING, "its width has changed", "{:.0%}"),
        )
        for value, limit, what, form in words:
            if value > limit:
                raise LINE_MOVED(
                    f"the laser line differs from its record: {what}",
                    limit=form.format(limit),
                    got=form.format(value),
                )


def fit_plane(points_mm: Array) -> LightPlane:
    """Fit a plane to three or more points (n, 3). Points on a straight line leave its turn undetermined."""
    middle = points_mm.mean(axis=0)
    _, singular, axes = np.linalg.svd(points_mm - middle, full_matrices=False)
    normal = axes[2] * (1.0 if axes[2][np.abs(axes[2]).argmax()] > 0.0 else -1.0)
    spread = singular / np.sqrt(len(points_mm))
    return LightPlane(normal, float(normal @ middle), float(spread[2]), (float(spread[0]), float(spread[1])))


def record_line(lines_mm: Sequence[Array], widths_mm: Sequence[float]) -> LineRecord:
    """Fit the plane of the light to lines (n, 3) each, scanned at different distances, and keep the width.

    Points further off than four times the usual scatter are left out. Raises STE-020 if the lines hardly
    differ in distance.
    """
    points = np.concatenate(lines_mm)
    distance = fit_plane(points).distance_mm(points)
    plane = fit_plane(points[np.abs(distance) <= OUTLIER_SIGMAS * robust_sigma(distance)])
    if plane.spread_mm[1] < LEAST_SPREAD_MM:
        raise LINE_PLANE_UNKNOWN(
            "the lines lie at nearly the same distance",
            limit=f"{LEAST_SPREAD_MM:g} mm between them, standard deviation",
            got=f"{plane.spread_mm[1]:.2g} mm",
        )
    x, y, z = plane.normal.tolist()
    return LineRecord(
        normal=(x, y, z),
        offset_mm=plane.offset_mm,
        rms_mm=plane.rms_mm,
        spread_mm=plane.spread_mm,
        width_mm=float(np.median(widths_mm)),
        lines=len(lines_mm),
    )
