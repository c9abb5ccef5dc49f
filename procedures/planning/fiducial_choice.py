"""Which fiducials a plan needs: the skin alone, the skin with few screws, or spheres alone.

Before a scan nobody knows how far the skin has moved, so the expectation is over what is usual. It is that of
the registration alone: arm, guide and instrument are not yet known, and a margin is compared with less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from procedures.planning.errors import NO_MARKER_SITES
from procedures.planning.head_in_ct import HeadEllipsoid
from procedures.planning.marker_sites import APART_MM, list_free_sites, propose_markers
from procedures.planning.plan_model import MOST_BESIDE_SKIN, Plan
from procedures.planning.skin_views import mark_scannable
from procedures.registration.points import validate_points
from procedures.registration.surface.regions import HeadAxes
from procedures.registration.surface.stations import ExpectedPose
from procedures.registration.surface.surface import Surface
from procedures.registration.surface.thinning import thin_points
from ronna_hw.arrays import Array
from ronna_hw.calibration import Numbers3
from ronna_hw.vectors import vector3

if TYPE_CHECKING:
    from procedures.imaging.volume import Volume

SPHERE_SD_MM = 0.1  # per axis: CT, seating, and a look by a calibrated arm (U)
ALONE_3D_MM = SPHERE_SD_MM * 3.0**0.5  # the same of a sphere without the skin, in space
SPHERES_ALONE = 5  # the usual number of them, for comparison
# Rms of what the arm at looks and target, guide and instrument add. Source: shares in a simulated case (U).
OTHERS_MM = 0.3
ASSUMED = (
    "a guess before the scan: the skin is assumed to move as it usually does, and arm, guide and instrument "
    f"to add {OTHERS_MM:g} mm rms"
)
LIMIT_OF_RMS = 1.61  # 95 % limit of an error alike in all directions, by its rms


@dataclass(frozen=True)
class TargetExpectation:
    """Expected error of a registration at one target, and with what comes after it, against the margin."""

    target: str
    rms_mm: float
    limit_mm: float
    margin_mm: float

    @property
    def total_mm(self) -> float:
        """Rms error with arm, guide and instrument."""
        return float(np.hypot(self.rms_mm, OTHERS_MM))

    @property
    def total_limit_mm(self) -> float:
        """95 % limit of that."""
        return float(np.hypot(self.limit_mm, LIMIT_OF_RMS * OTHERS_MM))

    @property
    def keeps_margin(self) -> bool:
        """Whether the total is within the margin in 95 of 100."""
        return self.total_limit_mm <= self.margin_mm


@dataclass(frozen=True)
class Fiducials:
    """A way to register: whether by the skin, the centres of spheres, and the expected errors."""

    with_skin: bool
    centres_mm: tuple[Numbers3, ...]
    expected: tuple[TargetExpectation, ...]

    @property
    def words(self) -> str:
        """Name it for people."""
        count = len(self.centres_mm)
        screws = f"{count} {'screw' if count == 1 else 'screws'}"
        if not self.with_skin:
            return f"{screws} alone"
        return f"skin and {screws}" if count else "skin alone"

    @property
    def keeps_margins(self) -> bool:
        """Whether the 95 % limit at every target is expected within its margin."""
        return all(one.keeps_margin for one in self.expected)

    def as_payload(self) -> dict[str, object]:
        """Return plain values for JSON."""
        targets = [
            {
                **asdict(one),
                "total_mm": one.total_mm,
                "total_limit_mm": one.total_limit_mm,
                "keeps_margin": one.keeps_margin,
            }
            for one in self.expected
        ]
        return {
            "words": self.words,
            "with_skin": self.with_skin,
            "centres_mm": [list(one) for one in self.centres_mm],
            "keeps_margins": self.keeps_margins,
            "targets": targets,
        }


def expect_with_skin(skin: Surface, spheres_mm: ArrayLike, plan: Plan) -> Fiducials:
    """Expect the errors by the skin that can be scanned, with spheres (n, 3), CT mm. Raises SRF-002."""
    return _expect(_pose_by(skin), validate_points(spheres_mm, "sphere"), plan)


def compare_fiducials(
    skin: Surface, head: HeadEllipsoid, plan: Plan, *, volume: Volume | None = None, seed: int = 0
) -> tuple[Fiducials, ...]:
    """Compare the skin with none to three screws at the best sites, and spheres alone.

    Screws are added one by one, each where it lowers the mean square error over the targets most: on the
    cranium, by the skin that the CT shows, or the ellipsoid without one. Raises PLAN-021 without room for
    them, SRF-002.
    """
    ways = [one.trajectory for one in plan.trajectories]
    targets = np.array([one.target_mm for one in plan.trajectories])
    axes = HeadAxes.of(skin)
    sites, _ = list_free_sites(head, ways, volume, np.random.default_rng(seed), axes)
    pose, chosen = _pose_by(skin), np.empty((0, 3))
    found = [_expect(pose, chosen, plan)]
    for _ in range(MOST_BESIDE_SKIN):
        is_apart = np.linalg.norm(sites[:, None] - chosen, axis=2).min(axis=1, initial=np.inf) >= APART_MM
        sites = sites[is_apart]
        if not len(sites):
            raise NO_MARKER_SITES("there is no room for a screw clear of the trajectories and the others")
        before = np.broadcast_to(chosen, (len(sites), *chosen.shape))
        tried = pose.with_spheres(np.concatenate([before, sites[:, None]], axis=1), SPHERE_SD_MM)
        chosen = np.vstack([chosen, sites[tried.mean_square_mm2(targets).argmin()]])
        found.append(_expect(pose, chosen, plan))
    alone = propose_markers(head, ways, SPHERES_ALONE, ALONE_3D_MM, volume=volume, axes=axes, seed=seed)
    expected = {one.target: one.expected_mm for one in alone.targets}
    found.append(
        Fiducials(
            with_skin=False,
            centres_mm=alone.centres_mm,
            expected=tuple(
                TargetExpectation(one.id, expected[one.id], LIMIT_OF_RMS * expected[one.id], one.margin_mm)
                for one in plan.trajectories
            ),
        )
    )
    return tuple(found)


def name_fewest(compared: Sequence[Fiducials]) -> str:
    """Name the first, with the fewest screws, that keeps all margins; or say that none does."""
    for one in compared:
        if one.keeps_margins:
            return f"{one.words}: the fewest screws that keep every margin"
    worst = min(compared, key=lambda one: max(at.limit_mm - at.margin_mm for at in one.expected))
    return f"nothing keeps every margin; {worst.words} comes nearest"


def _pose_by(skin: Surface) -> ExpectedPose:
    scanned = mark_scannable(skin)
    points, normals = skin.points_mm[scanned], skin.normals[scanned]
    rows = thin_points(points)
    return ExpectedPose.of(points[rows], normals[rows])


def _expect(pose: ExpectedPose, spheres_mm: Array, plan: Plan) -> Fiducials:
    known = pose.with_spheres(spheres_mm, SPHERE_SD_MM)
    expected = []
    for one in plan.trajectories:
        at = known.at(np.array(one.target_mm))
        expected.append(TargetExpectation(one.id, at.rms_mm, at.limit_mm(), one.margin_mm))
    return Fiducials(True, tuple(vector3(one) for one in spheres_mm), tuple(expected))
