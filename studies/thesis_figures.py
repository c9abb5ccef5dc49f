"""Figures of the thesis that need no campaign: 4 to 6, registration of two sets, and 11, the matrix.

Figure 4 fits paired points by SVD, 5 aligns principal axes, 6 pairs closest points. The thesis' own points
are not published. The surface is the upper half of an ellipsoid with a nose; the reading for figure 11 is one
of the pairing study's, with four outliers in each set as in the thesis.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.registration.cloud_registration import closest_point_steps, principal_axes
from procedures.registration.correspondence import MatchStatus
from procedures.registration.rigid_fit import RigidFit, fit_rigid
from procedures.registration.similarity_matrix import SimilarityPairs, SimilarityStep, similarity_steps
from ronna_hw.arrays import Array
from studies.campaign.plots import encode_png
from studies.heads import HALF_AXES_MM, NoiseReading, draw_readings, sites_mm

POINTS = 600
SURFACE_NOISE_MM = 0.5
MARKER_NOISE_MM = 0.5  # per axis, in each set
NOSE_MM = 25.0  # of the surface's front, so that it fits in one orientation only
NOSE_WIDTH = 0.15  # share of the directions around the front
MOVED_MM = (40.0, -25.0, 30.0)
TURNED_RAD = (0.5, -0.3, 0.8)  # Euler angles about x, y and z
MATRIX_FIDUCIALS, MATRIX_OUTLIERS, MATRIX_E_MM = 4, 4, 1.5
SHOWN_STEPS = 4  # of the closest points


@dataclass(frozen=True, eq=False)
class PairedPoints:
    """Markers (n, 3) in image and room, mm, paired row by row, and their fit by SVD."""

    image_mm: Array
    physical_mm: Array
    fit: RigidFit

    @property
    def mapped_mm(self) -> Array:
        """Image points as the fit places them in the room."""
        return np.asarray(self.image_mm @ self.fit.rotation.T + self.fit.translation_mm)

    @property
    def fre_mm(self) -> float:
        """Rms residual of the fit."""
        return float(np.sqrt(np.square(self.physical_mm - self.mapped_mm).sum(axis=1).mean()))


@dataclass(frozen=True, eq=False)
class Surfaces:
    """Two readings (n, 3), mm, of one surface, not point by point, and the motion between them."""

    image_mm: Array
    physical_mm: Array
    physical_from_image: RigidTransform


def draw_surfaces(seed: int = 0) -> Surfaces:
    """Draw two readings of a head's upper half with a nose, the second one moved."""
    random = np.random.default_rng(seed)
    motion = RigidTransform.from_components(MOVED_MM, Rotation.from_euler("xyz", TURNED_RAD))
    image = _draw_surface(random)
    return Surfaces(image, np.asarray(motion.apply(_draw_surface(random))), motion)


def _draw_surface(random: np.random.Generator) -> Array:
    directions = random.normal(size=(POINTS, 3))
    directions[:, 2] = np.abs(directions[:, 2])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    nose = np.exp(-((directions[:, 1] + 1.0) / NOSE_WIDTH))
    points = directions * np.array(HALF_AXES_MM[1]) + NOSE_MM * nose[:, None] * directions
    return np.asarray(points + random.normal(size=points.shape) * SURFACE_NOISE_MM)


def draw_pairs(seed: int = 0) -> PairedPoints:
    """Draw a head's markers in image and room, moved as the surfaces are, and fit them by SVD."""
    random = np.random.default_rng(seed)
    motion = RigidTransform.from_components(MOVED_MM, Rotation.from_euler("xyz", TURNED_RAD))
    sites = sites_mm(1)
    image = sites + random.normal(size=sites.shape) * MARKER_NOISE_MM
    physical = np.asarray(motion.apply(sites)) + random.normal(size=sites.shape) * MARKER_NOISE_MM
    return PairedPoints(image, physical, fit_rigid(image, physical))


def draw_matrix_run(seed: int = 0) -> tuple[tuple[SimilarityStep, ...], SimilarityPairs]:
    """Return the iterations of the first reading, from a seed on, that the thesis' method pairs."""
    while True:
        readings = draw_readings(
            sites_mm(1),
            MATRIX_FIDUCIALS,
            MATRIX_OUTLIERS,
            NoiseReading.NORM,
            1,
            np.random.default_rng(seed),
        )
        steps, found = similarity_steps(
            readings.image_mm[0], readings.physical_mm[0], MATRIX_E_MM, MATRIX_FIDUCIALS
        )
        if found.status is MatchStatus.UNIQUE:
            return steps, found
        seed += 1


def figures(seed: int = 0) -> dict[str, bytes]:
    """Draw all figures of this module as PNG, by file name."""
    surfaces = draw_surfaces(seed)
    return {
        "figure-4-paired-points.png": _draw_pairs(draw_pairs(seed)),
        "figure-5-principal-axes.png": _draw_axes(surfaces),
        "figure-6-closest-points.png": _draw_steps(surfaces),
        "figure-6-residual.png": _draw_residuals(surfaces),
        "figure-11-similarity-matrix.png": _draw_matrices(*draw_matrix_run(seed)),
    }


def _draw_pairs(pairs: PairedPoints) -> bytes:
    figure, all_axes = _open_figure(1, 2)
    named = {"as read": pairs.image_mm, "fitted by SVD": pairs.mapped_mm}
    for axes, (name, image_mm) in zip(all_axes, named.items(), strict=True):
        for one, other in zip(image_mm, pairs.physical_mm, strict=True):
            axes.plot(*np.array([one, other])[:, (0, 2)].T, "-", color="grey", lw=0.7)
        axes.plot(*image_mm[:, (0, 2)].T, "o", color="C0", label="image")
        axes.plot(*pairs.physical_mm[:, (0, 2)].T, "x", color="C1", label="room")
        axes.set_title(name, fontsize=9)
        _label_view(axes, (0, 2))
    all_axes[0].legend(fontsize=8)
    figure.suptitle(f"Paired points, FRE {pairs.fre_mm:.2f} mm", fontsize=9)
    return encode_png(figure)


def _draw_axes(surfaces: Surfaces) -> bytes:
    figure, all_axes = _open_figure(1, 2)
    clouds = {"image": surfaces.image_mm, "physical": surfaces.physical_mm}
    for axes, view in zip(all_axes, ((0, 2), (1, 2)), strict=True):
        for colour, (name, points) in enumerate(clouds.items()):
            middle, directions = points.mean(axis=0), principal_axes(points, name)
            axes.plot(*points[:, view].T, ".", markersize=2, color=f"C{colour}", label=name)
            for length, direction in zip((100.0, 70.0, 40.0), directions.T, strict=True):
                ends = np.array([middle, middle + length * direction])[:, view]
                axes.plot(*ends.T, "-", color="black", lw=1.5)
        _label_view(axes, view)
    all_axes[0].legend(fontsize=8)
    all_axes[0].set_title("Two clouds and their principal axes", fontsize=9)
    return encode_png(figure)


def _draw_steps(surfaces: Surfaces) -> bytes:
    steps = list(closest_point_steps(surfaces.image_mm, surfaces.physical_mm))
    shown = np.unique(np.linspace(0, len(steps) - 1, SHOWN_STEPS).astype(int))
    figure, all_axes = _open_figure(1, len(shown))
    for axes, number in zip(all_axes, shown.tolist(), strict=True):
        matrix, residual_mm = steps[number]
        moved = surfaces.image_mm @ matrix[:3, :3].T + matrix[:3, 3]
        for colour, points in enumerate((moved, surfaces.physical_mm)):
            axes.plot(*points[:, (0, 2)].T, ".", markersize=2, color=f"C{colour}")
        axes.set_title(f"step {number}: {residual_mm:.2f} mm", fontsize=9)
        _label_view(axes, (0, 2))
    return encode_png(figure)


def _draw_residuals(surfaces: Surfaces) -> bytes:
    figure, (axes,) = _open_figure(1, 1)
    steps = list(closest_point_steps(surfaces.image_mm, surfaces.physical_mm))
    axes.plot(range(len(steps)), [residual_mm for _, residual_mm in steps], marker=".")
    axes.set_xlabel("step")
    axes.set_ylabel("rms distance to the nearest point, mm")
    axes.set_title("Iterative closest points, from the principal axes", fontsize=9)
    axes.grid(alpha=0.3)
    return encode_png(figure)


def _draw_matrices(steps: tuple[SimilarityStep, ...], found: SimilarityPairs) -> bytes:
    figure, all_axes = _open_figure(1, len(steps))
    for number, (axes, step) in enumerate(zip(all_axes, steps, strict=True), start=1):
        passing = step.matrix >= MATRIX_FIDUCIALS - 1
        axes.imshow(passing, vmin=0, vmax=2, cmap="Blues")
        for row, column in np.ndindex(step.matrix.shape):
            weight = "bold" if passing[row, column] else "normal"
            cell = str(step.matrix[row, column])
            axes.text(column, row, cell, ha="center", va="center", fontsize=8, weight=weight)
        axes.set_yticks(range(len(step.rows)), [f"{one + 1}" for one in step.rows])
        axes.set_xticks(range(len(step.columns)), [f"{chr(65 + one)}" for one in step.columns])
        axes.set_title(f"iteration {number}", fontsize=9)
    pairs = ", ".join(f"{i + 1}-{chr(65 + j)}" for i, j in found.pairs.tolist())
    title = f"Similarity matrix, e = {MATRIX_E_MM:g} mm, at least {MATRIX_FIDUCIALS - 1} in bold: {pairs}"
    figure.suptitle(title, fontsize=9)
    return encode_png(figure)


def _open_figure(rows: int, columns: int) -> tuple[Any, list[Any]]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(max(5.0, 3.0 * columns), 3.4 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, list(figure.subplots(rows, columns, squeeze=False).ravel())


def _label_view(axes: Any, view: tuple[int, int]) -> None:
    axes.set_aspect("equal")
    axes.set_xlabel(f"{'xyz'[view[0]]}, mm")
    axes.set_ylabel(f"{'xyz'[view[1]]}, mm")
