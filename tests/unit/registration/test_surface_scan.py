"""A scan keeps its points with their origin, and refuses numbers that mean nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from procedures.registration.surface.scan import SurfaceScan
from ronna_hw.errors import DataError


def rows(count: int = 4, **changed: Any) -> dict[str, Any]:
    points = np.arange(3.0 * count).reshape(count, 3)
    given = {
        "points_mm": points,
        "covariance_mm2": np.broadcast_to(np.diag([1e-4, 4e-4, 9e-4]), (count, 3, 3)),
        "look": np.zeros(count, int),
        "line": np.arange(count),
        "view_mm": points + np.array([0.0, 0.0, 200.0]),
    }
    return given | changed


def test_looks_are_joined_in_their_order_and_rows_selected() -> None:
    first, second = SurfaceScan(**rows()), SurfaceScan(**rows(2, look=[1, 1]))

    scan = SurfaceScan.join([first, second])

    assert scan.look.tolist() == [0, 0, 0, 0, 1, 1]
    assert scan.select(scan.look == 1).line.tolist() == [0, 1]


@pytest.mark.parametrize(
    "changed",
    [
        {"points_mm": np.full((4, 3), np.nan)},
        {"points_mm": np.full((4, 3), 1e7)},
        {"points_mm": "a cloud"},
        {"covariance_mm2": np.zeros((4, 3, 3))},
        {"covariance_mm2": np.ones((3, 3, 3))},
        {"look": [0.5, 0.0, 0.0, 0.0]},
        {"line": [0, 1, 2]},
        {"view_mm": np.zeros(3)},
    ],
    ids=lambda changed: next(iter(changed)),
)
def test_a_scan_with_meaningless_numbers_is_refused(changed: dict[str, Any]) -> None:
    with pytest.raises(DataError, match="SRF-020"):
        SurfaceScan(**rows(**changed))


def test_no_points_at_all_are_refused() -> None:
    with pytest.raises(DataError, match="SRF-021"):
        SurfaceScan.join([SurfaceScan(**rows(0))])
