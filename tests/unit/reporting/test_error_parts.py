"""Picture of true, registered and reached target."""

from __future__ import annotations

import math

import pytest

from procedures.reporting.error_parts import ErrorTriangle
from procedures.reporting.outcome import ErrorParts

ERRORS_MM = ((1.0, 2.0, -2.0), (-1.0, -1.5, 2.2)), ((0.0, 0.0, 0.0), (0.0, 0.3, 0.4))


@pytest.mark.parametrize(("registration_mm", "intrinsic_mm"), ERRORS_MM)
def test_the_picture_has_the_lengths_of_all_three_sides(
    registration_mm: tuple[float, float, float], intrinsic_mm: tuple[float, float, float]
) -> None:
    parts = ErrorParts(registration_mm=registration_mm, intrinsic_mm=intrinsic_mm)
    drawn = ErrorTriangle.of(parts)
    error_mm = math.dist((0.0, 0.0, 0.0), [a + b for a, b in zip(registration_mm, intrinsic_mm, strict=True)])
    assert math.hypot(*drawn.registered_mm) == pytest.approx(parts.lengths_mm["registration"])
    assert math.dist(drawn.registered_mm, drawn.reached_mm) == pytest.approx(parts.lengths_mm["intrinsic"])
    assert math.hypot(*drawn.reached_mm) == pytest.approx(error_mm)
