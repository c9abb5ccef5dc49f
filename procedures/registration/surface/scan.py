"""Cloud of points on a scanned surface, with the covariance and the origin of each point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.registration.points import COORDINATE_LIMIT_MM, SYMMETRY_TOLERANCE
from procedures.registration.surface.errors import BAD_SCAN, EMPTY_SCAN
from ronna_hw.arrays import Array
from ronna_hw.frames import Transform

NAMED_ROWS = 5  # of those that are wrong, in a message

Numbers = NDArray[np.int64]


@dataclass(frozen=True)
class SurfaceScan:
    """Points (n, 3) on a surface in the robot frame, and where each comes from.

    `covariance_mm2` (n, 3, 3) is the noise of the measurement of a point alone: not the errors of arm, head
    and surface that points share. `look` (n,) numbers the arm's pose from which it was seen, and `line` (n,)
    the line of light; points of one look share the errors of the arm. `view_mm` (n, 3) is the place of the
    projector or camera at that moment, on the outer side of the surface. Raises SRF-020 for other shapes,
    numbers that are not finite, and covariances that are not positive definite.
    """

    points_mm: Array
    covariance_mm2: Array
    look: Numbers
    line: Numbers
    view_mm: Array

    def __post_init__(self) -> None:
        count = np.shape(self.points_mm)[0] if np.ndim(self.points_mm) else 0
        shapes = {"points_mm": (3,), "covariance_mm2": (3, 3), "view_mm": (3,), "look": (), "line": ()}
        for name, each in shapes.items():
            values = _as_rows(getattr(self, name), (count, *each), name)
            object.__setattr__(self, name, values)
        _require_near(self.points_mm, "points_mm")
        _require_near(self.view_mm, "view_mm")
        _require_positive(self.covariance_mm2)

    def __len__(self) -> int:
        return len(self.points_mm)

    @classmethod
    def join(cls, parts: Sequence[SurfaceScan]) -> Self:
        """Return one scan of all points, in the order of its parts. Raises SRF-021 without any point."""
        if not any(len(part) for part in parts):
            raise EMPTY_SCAN("there is no point to register", got=f"{len(parts)} line(s) without points")
        columns = {one.name: [getattr(part, one.name) for part in parts] for one in fields(cls)}
        return cls(**{name: np.concatenate(arrays) for name, arrays in columns.items()})

    def placed(self, pose: Transform) -> Self:
        """Return the scan in another frame, or of a head that has moved."""
        turn = pose.rotation_matrix
        turned = turn @ self.covariance_mm2 @ turn.T
        return replace(
            self,
            points_mm=pose.apply(self.points_mm),
            covariance_mm2=0.5 * (turned + turned.transpose(0, 2, 1)),
            view_mm=pose.apply(self.view_mm),
        )

    def noise_along_mm2(self, directions: Array) -> Array:
        """Return the variance (n,) mm2 of each point along its unit direction (n, 3), frame of the scan."""
        return np.asarray(np.einsum("ni,nij,nj->n", directions, self.covariance_mm2, directions))

    def select(self, rows: ArrayLike) -> Self:
        """Return the scan of these rows only, given by number or by a mask (n,)."""
        chosen = np.asarray(rows)
        return type(self)(**{one.name: getattr(self, one.name)[chosen] for one in fields(self)})


def _as_rows(given: object, shape: tuple[int, ...], name: str) -> Array | Numbers:
    is_number = len(shape) == 1  # of a look or a line
    try:
        values = np.array(given, dtype=float)
    except (TypeError, ValueError) as error:
        raise BAD_SCAN(f"{name} is no array of numbers", expected=str(shape)) from error
    if values.shape != shape:
        raise BAD_SCAN(f"{name} has another shape", expected=str(shape), got=str(values.shape))
    wrong = np.flatnonzero(~np.isfinite(values).all(axis=tuple(range(1, values.ndim))))
    if len(wrong):
        rows = ", ".join(str(row) for row in wrong[:NAMED_ROWS])
        raise BAD_SCAN(f"{name} has numbers that are not finite", got=f"{len(wrong)} row(s), first {rows}")
    if not is_number:
        return values
    if np.any(values != np.floor(values)) or np.any(values < 0):
        raise BAD_SCAN(f"{name} is no number of a {name}", expected="whole numbers from 0")
    return values.astype(np.int64)


def _require_near(points_mm: Array, name: str) -> None:
    farthest_mm = float(np.abs(points_mm).max(initial=0.0))
    if farthest_mm > COORDINATE_LIMIT_MM:
        raise BAD_SCAN(
            f"{name} lie farther away than any theatre is wide",
            limit=f"{COORDINATE_LIMIT_MM:g} mm",
            got=f"{farthest_mm:g} mm",
        )


def _require_positive(covariance_mm2: Array) -> None:
    if not len(covariance_mm2):
        return
    skew = np.abs(covariance_mm2 - covariance_mm2.transpose(0, 2, 1)).max(axis=(1, 2))
    size = np.abs(covariance_mm2).max(axis=(1, 2))
    smallest = np.linalg.eigvalsh(covariance_mm2)[:, 0]
    wrong = np.flatnonzero((skew > SYMMETRY_TOLERANCE * size) | (smallest <= 0.0))
    if len(wrong):
        raise BAD_SCAN(
            "covariance_mm2 has rows that are not symmetric and positive definite",
            got=f"{len(wrong)} row(s), first {int(wrong[0])}",
        )
