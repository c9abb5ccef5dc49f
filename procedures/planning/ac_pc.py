"""AC-PC frame of a brain: from the commissures and a point of the midline to atlas coordinates.

Origin halfway between the commissures; x to the patient's right, y from PC to AC, z up. The third point, on
the midline and away from the line through the commissures, fixes the rotation about that line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from procedures.planning.errors import AcPcUnfit
from ronna_hw.arrays import Array
from ronna_hw.vectors import vector3

# Adult commissures are 19 to 32 mm apart, centre to centre (unconfirmed). The limits leave room for children
# and wide ventricles; they catch clicks on one commissure twice or on another structure, and metres.
LEAST_AC_PC_MM, MOST_AC_PC_MM = 10.0, 50.0
LEAST_OFF_LINE_MM = 10.0  # a click 0.5 mm to the side then turns the frame by 3 degrees
# Between x and the right side of the scan: no head is scanned as oblique as this.
LARGEST_TURN_DEG = 45.0
ANTERIOR, RIGHT = np.array([0.0, -1.0, 0.0]), np.array([-1.0, 0.0, 0.0])  # LPS
BEGIN_ANEW = "AC stays set; if it is wrong, remove the points and click AC first"


@dataclass(frozen=True, eq=False)
class AcPcFrame:
    """AC-PC frame in LPS mm. The rows of `axes` (3, 3) are its x, y and z: right, anterior, superior."""

    middle_mm: Array  # between AC and PC
    axes: Array
    length_mm: float  # from AC to PC

    @classmethod
    def from_points(
        cls, ac_mm: Sequence[float], pc_mm: Sequence[float], midline_mm: Sequence[float]
    ) -> AcPcFrame:
        """Build the frame from three points in LPS mm. Raises PLAN-031 for points that do not give one."""
        ac, pc, midline = (np.asarray(point, dtype=float) for point in (ac_mm, pc_mm, midline_mm))
        y, length_mm = _find_direction(ac, pc)
        middle = (ac + pc) / 2.0
        away = midline - middle
        up = away - (away @ y) * y
        off_line_mm = float(np.linalg.norm(up))
        if off_line_mm < LEAST_OFF_LINE_MM:
            raise AcPcUnfit(
                "the midline point is too close to the line through AC and PC",
                expected=f"at least {LEAST_OFF_LINE_MM:g} mm",
                got=f"{off_line_mm:.1f} mm",
                action="Click a point of the midline far above the commissures, such as on the falx.",
            )
        z = up / off_line_mm
        x = np.cross(y, z)
        if x @ RIGHT < 0.0:  # a point of the midline below the commissures is as good as one above
            x, z = -x, -z
        turn_deg = float(np.degrees(np.arccos(np.clip(x @ RIGHT, -1.0, 1.0))))
        if turn_deg > LARGEST_TURN_DEG:
            raise AcPcUnfit(
                "the third point is beside the midline",
                expected=f"the frame's right within {LARGEST_TURN_DEG:g} degrees of the scan's",
                got=f"{turn_deg:.0f} degrees",
                action="Click a point between the hemispheres, such as on the falx.",
            )
        return cls(middle, np.stack([x, y, z]), length_mm)

    def from_lps_mm(self, place_mm: Sequence[float]) -> tuple[float, float, float]:
        """Convert a point from LPS to x, y, z of the frame."""
        return vector3(self.axes @ (np.asarray(place_mm, dtype=float) - self.middle_mm))

    def to_lps_mm(self, place_mm: Sequence[float]) -> tuple[float, float, float]:
        """Convert a point from x, y, z of the frame to LPS."""
        return vector3(self.middle_mm + np.asarray(place_mm, dtype=float) @ self.axes)


def require_commissures(ac_mm: Sequence[float], pc_mm: Sequence[float]) -> None:
    """Raise PLAN-031 if two points cannot be AC and PC."""
    _find_direction(np.asarray(ac_mm, dtype=float), np.asarray(pc_mm, dtype=float))


def _find_direction(ac: Array, pc: Array) -> tuple[Array, float]:
    """Return the unit vector from PC to AC, and their distance in mm."""
    length_mm = float(np.linalg.norm(ac - pc))
    if not LEAST_AC_PC_MM <= length_mm <= MOST_AC_PC_MM:
        raise AcPcUnfit(
            "AC and PC are not as far apart as in any brain",
            expected=f"{LEAST_AC_PC_MM:g} to {MOST_AC_PC_MM:g} mm",
            got=f"{length_mm:.1f} mm",
            action=f"Click PC again; {BEGIN_ANEW}.",
        )
    direction = (ac - pc) / length_mm
    if direction @ ANTERIOR <= 0.0:
        raise AcPcUnfit(
            "AC is behind PC",
            expected="AC nearer to the face",
            got=f"{-float(direction @ ANTERIOR) * length_mm:.1f} mm farther back",
            action=f"Click PC again, behind AC; {BEGIN_ANEW}. In a plan file, its points may be in RAS.",
        )
    return direction, length_mm
