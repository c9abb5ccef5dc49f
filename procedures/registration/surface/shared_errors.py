"""Errors of the arm that the points of a scan share, as displacements of each point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from procedures.registration.points import SYMMETRY_TOLERANCE
from procedures.registration.surface.errors import BAD_SURFACE_INPUT
from procedures.registration.surface.scan import SurfaceScan
from procedures.registration.target_prediction import AXES, IndependentErrors, SharedErrors
from ronna_hw.arrays import Array

Sources = Sequence[SharedErrors | IndependentErrors]


@dataclass(frozen=True, eq=False)
class ErrorColumns:
    """Displacements (n, 3, k) mm of the points of a scan by k errors of one standard deviation each.

    An independent error of a look displaces all of its points, so it takes three columns for each look.
    Looks at spheres follow the points.
    """

    displacements_mm: Array
    sources: tuple[tuple[str, int], ...]  # names, and numbers of their columns
    spheres: int = 0  # rows that are looks at spheres

    @classmethod
    def of(cls, sources: Sources, scan: SurfaceScan, rows: NDArray[np.int64], spheres: int = 0) -> Self:
        """Collect the columns for some points of a scan. Raises SRF-001 for other numbers of rows.

        A source has a row for each look, in the order of their numbers, or a shared one for each point; then
        one for each look at a sphere.
        """
        looks, look_of = np.unique(scan.look, return_inverse=True)
        columns, names = [np.zeros((len(rows) + spheres, AXES, 0))], list[tuple[str, int]]()
        for one in sources:
            given = len(one.at_spheres_mm if isinstance(one, SharedErrors) else one.at_spheres_mm2)
            is_by_point = isinstance(one, SharedErrors) and given == len(scan) + spheres
            if given != len(looks) + spheres and not is_by_point:
                raise BAD_SURFACE_INPUT(
                    f"the source '{one.source}' does not fit the scan",
                    expected=f"{len(looks) + spheres} rows, one for each look",
                    got=f"{given}",
                )
            of_rows = rows if is_by_point else look_of[rows]
            columns.append(by_look(one)[np.append(of_rows, given - spheres + np.arange(spheres))])
            names.append((one.source, columns[-1].shape[2]))
        displacements = np.concatenate(columns, axis=2)
        if not np.isfinite(displacements).all():
            raise BAD_SURFACE_INPUT("an error of the arm is not finite")
        return cls(displacements, tuple(names), spheres)

    def along(self, directions: Array) -> Array:
        """Return the displacements (n, k) of points along directions (n, 3) of the robot frame."""
        return np.asarray(np.einsum("ni,nik->nk", directions, self.displacements_mm[: len(directions)]))

    def of_spheres(self) -> Array:
        """Return the displacements (3m, k) of looks at spheres, along each axis of the robot frame."""
        rows = self.displacements_mm[len(self.displacements_mm) - self.spheres :]
        return np.asarray(rows.reshape(AXES * self.spheres, -1))


def by_look(source: SharedErrors | IndependentErrors) -> Array:
    """Return the displacements (m, 3, k) of the rows of a source by its errors. Raises SRF-001."""
    if isinstance(source, SharedErrors):
        return source.at_spheres_mm
    sizes, axes = np.linalg.eigh(source.at_spheres_mm2)
    if sizes.size and sizes.min() < -SYMMETRY_TOLERANCE * max(float(sizes.max()), 1.0):
        raise BAD_SURFACE_INPUT(f"the source '{source.source}' has a negative variance")
    roots = axes * np.sqrt(np.maximum(sizes, 0.0))[:, None, :]
    looks = len(roots)
    columns = np.zeros((looks, AXES, looks, AXES))
    columns[np.arange(looks), :, np.arange(looks)] = roots
    return columns.reshape(looks, AXES, looks * AXES)


@dataclass(frozen=True, eq=False)
class AtTarget:
    """Error of one source at a target: displacements (3, k) by its errors at the looks, and beside them."""

    source: str
    shared_mm: Array
    independent_mm2: Array

    @classmethod
    def of(cls, sources: Sources, columns: Sequence[tuple[str, int]]) -> tuple[AtTarget, ...]:
        """Match the sources at a target by name to those of the looks, in their order; the others follow.

        A source that the looks do not have is independent of them, one that the target does not have is zero
        there. Raises SRF-001 for another number of columns.
        """
        left, found = list(sources), []
        for name, count in columns:
            number = next((row for row, one in enumerate(left) if one.source == name), None)
            here = cls._of(left.pop(number)) if number is not None else None
            if here is None:
                here = cls(name, np.zeros((AXES, count)), np.zeros((AXES, AXES)))
            if here.shared_mm.shape[1] != count:
                raise BAD_SURFACE_INPUT(
                    f"the source '{name}' differs between looks and target",
                    expected=f"{count} errors",
                    got=f"{here.shared_mm.shape[1]}",
                )
            found.append(here)
        for one in map(cls._of, left):
            beside_mm2 = one.independent_mm2 + one.shared_mm @ one.shared_mm.T
            found.append(cls(one.source, np.zeros((AXES, 0)), beside_mm2))
        return tuple(found)

    @classmethod
    def _of(cls, one: SharedErrors | IndependentErrors) -> AtTarget:
        if isinstance(one, SharedErrors):
            return cls(one.source, one.at_target_mm, np.zeros((AXES, AXES)))
        return cls(one.source, np.zeros((AXES, AXES * len(one.at_spheres_mm2))), one.at_target_mm2)
