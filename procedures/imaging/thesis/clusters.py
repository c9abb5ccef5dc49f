"""The thesis' pipeline, steps 4 and 5: clusters circles of neighbouring planes, and filters the clusters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.thesis.circles import Circles

Array = NDArray[np.float64]

IN_PLANE_MM = 1.0  # centres of one sphere's circles are stacked
GAP_MM = 2.1  # a plane or two without a circle
HEIGHT_SHARE = (0.35, 1.10)  # of the diameter: planes in which a sphere shows circles
MIN_CIRCLES = 4
SPHERE_TOLERANCE_MM = 0.6  # between a circle's radius and the sphere's section at that height
MEETING_MM = 2.0  # between the centres of one sphere's axial and sagittal clusters


@dataclass(frozen=True, eq=False)
class Cluster:
    """Stacked circles of one plane direction, and the sphere centre they imply."""

    centres_mm: Array
    radii_mm: Array
    axis: int
    middle_mm: Array


def cluster_circles(circles: Circles, radius_mm: float) -> list[Cluster]:
    """Clusters whose circles grow and shrink like those of a sphere of `radius_mm`."""
    order = np.argsort(circles.centres_mm[:, circles.axis], kind="stable")
    across = [other for other in range(3) if other != circles.axis]
    open_chains: list[list[int]] = []
    for index in order.tolist():
        centre = circles.centres_mm[index]
        for chain in open_chains:
            centres = circles.centres_mm[chain]
            step_mm = centre[circles.axis] - centres[-1, circles.axis]
            # Compared with the median: one misplaced circle must not split those above from those below it.
            beside_mm = float(np.linalg.norm(centre[across] - np.median(centres[:, across], axis=0)))
            if 0.0 < step_mm <= GAP_MM and beside_mm <= IN_PLANE_MM:
                chain.append(index)
                break
        else:
            open_chains.append([index])
    clusters = (_as_cluster(circles, chain, radius_mm) for chain in open_chains if len(chain) >= MIN_CIRCLES)
    return [cluster for cluster in clusters if cluster is not None]


def meeting_clusters(axial: list[Cluster], sagittal: list[Cluster]) -> list[tuple[Cluster, Cluster]]:
    """Pairs of one cluster from each stack around the same point, nearest first; each is used once."""
    pairs = sorted(
        (float(np.linalg.norm(one.middle_mm - other.middle_mm)), i, j)
        for i, one in enumerate(axial)
        for j, other in enumerate(sagittal)
    )
    used: set[tuple[int, int]] = set()
    found = []
    for distance_mm, i, j in pairs:
        if distance_mm > MEETING_MM or (0, i) in used or (1, j) in used:
            continue
        used |= {(0, i), (1, j)}
        found.append((axial[i], sagittal[j]))
    return found


def _as_cluster(circles: Circles, chain: list[int], radius_mm: float) -> Cluster | None:
    centres_mm, radii_mm = circles.centres_mm[chain], circles.radii_mm[chain]
    height_mm = centres_mm[:, circles.axis]
    # the height of the centre that makes the circles fit a sphere best: r² = R² - (h - h0)²
    halves = np.sqrt(np.maximum(radius_mm**2 - radii_mm**2, 0.0))
    candidates = np.concatenate([height_mm - halves, height_mm + halves])
    cuts = np.sqrt(np.maximum(radius_mm**2 - (height_mm[None, :] - candidates[:, None]) ** 2, 0.0))
    fits = np.abs(cuts - radii_mm[None, :]) < SPHERE_TOLERANCE_MM
    near = np.abs(candidates - np.median(height_mm)) < radius_mm
    best = int(np.argmax(np.where(near, fits.sum(axis=1), -1)))
    keep = fits[best]
    if keep.sum() < MIN_CIRCLES:
        return None
    extent_mm = float(np.ptp(height_mm[keep]))
    if not HEIGHT_SHARE[0] < extent_mm / (2.0 * radius_mm) < HEIGHT_SHARE[1]:
        return None
    middle_mm = np.median(centres_mm[keep], axis=0)
    middle_mm[circles.axis] = float(np.mean(candidates[(fits == keep).all(axis=1)]))
    return Cluster(centres_mm[keep], radii_mm[keep], circles.axis, middle_mm)
