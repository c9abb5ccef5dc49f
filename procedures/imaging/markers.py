"""Localizer results: markers, candidates, and the doubts that tell them apart."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from ronna_hw.arrays import Array
from ronna_hw.calibration import Numbers3

STEEPNESS = 4.0  # at twice a limit the odds are 1 to 16
EVEN = 0.5
WORTH_TELLING = 0.5  # of a limit

Numbers5 = tuple[float, float, float, float, float]

ESTIMATORS_DISAGREE = "estimators_disagree"  # the two centres are more than 0.06 mm apart
CUT_BY_FIELD = "cut_by_field"  # part of the surface is outside the scanned volume
NEAR_METAL = "near_metal"  # metal hides more of the surface than a post does
SURFACE_HIDDEN = "surface_hidden"  # skin, bandage or a neighbour hides much of the surface
RADIUS_UNUSUAL = "radius_unusual"  # the fitted radius is far from nominal
NEAR_ANOTHER = "near_another"  # the surface of another marker is close
STREAKED = "streaked"  # by metal, so much that streaks were fitted together with the sphere
PICKED = "picked"  # a person indicated where to search


class Marker(BaseModel):
    """One marker sphere in the CT."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    centre_mm: Numbers3 = Field(description="Centre, LPS.")
    # From noise, metal streaks and, where the two estimators are combined (not in a `streaked` sphere), their
    # disagreement. Errors common to a whole scan, such as table feed, are not in it.
    covariance_mm2: tuple[Numbers3, Numbers3, Numbers3] = Field(description="Covariance of the centre, LPS.")
    # Of a uniform ball with the inner intensity and the same total attenuation. The model removes blur; a
    # retro-reflective film remains: too thin to be resolved, a film of thickness t adds about
    # t (film - out) / (in - out), which is 0.14 mm for 0.1 mm at 600 HU on a polymer of 125 HU in air.
    radius_mm: float = Field(description="Fitted radius.")
    quality: float = Field(
        description="Share of the surface used, 0 to 1, reduced by disagreement of the estimates."
    )
    agreement_mm: float = Field(description="Distance between the two estimates of the centre.")
    flags: tuple[str, ...] = Field(description="Reasons that make it less certain.")
    odds: float = Field(description="That it is a marker, 0 to 1, at least even.")

    @property
    def sigma_mm(self) -> float:
        """Predicted 3-D rms error of the centre."""
        return float(np.sqrt(np.trace(np.array(self.covariance_mm2))))

    def document(self) -> dict[str, Any]:
        """Return the marker as plain data for JSON, omitting the agreement."""
        return self.model_dump(mode="json", exclude={"agreement_mm"})


class ScanDeformation(BaseModel):
    """Stretch and shear of a scan as its spheres show it, without a common scale."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    spheres: int = Field(description="How many show it.")
    strain: tuple[Numbers3, Numbers3, Numbers3] = Field(
        description="Relative stretch along L, P, S, and off the diagonal half the angle of shear; no trace."
    )
    covariance: tuple[Numbers5, Numbers5, Numbers5, Numbers5, Numbers5] = Field(
        description="Covariance of its LL, PP, LP, LS and PS."
    )
    chi_square: float = Field(description="Of the strain against zero, 5 degrees of freedom.")
    limit: float = Field(description="Chi-square that one undistorted scan in a thousand exceeds.")


@dataclass(frozen=True, eq=False)
class Localization:
    """Markers found in one volume, from superior to inferior, and all candidates.

    `deformation` is what the markers together show of the scan, None if no shape could be measured.
    """

    markers: tuple[Marker, ...]
    candidates: tuple[Candidate, ...]
    series_instance_uid: str
    frame_of_reference_uid: str
    diameter_mm: float
    deformation: ScanDeformation | None = None

    @property
    def doubtful(self) -> tuple[Candidate, ...]:
        """Right-sized candidates that may not be whole spheres, most likely first."""
        return tuple(likeliest_first(one for one in self.candidates if one.doubtful))

    @property
    def centres_mm(self) -> Array:
        """Centres of all markers, (n, 3) LPS mm."""
        return np.array([marker.centre_mm for marker in self.markers]).reshape(-1, 3)

    @property
    def covariances_mm2(self) -> Array:
        """Covariances of all centres, (n, 3, 3) LPS mm²."""
        return np.array([marker.covariance_mm2 for marker in self.markers]).reshape(-1, 3, 3)


@dataclass(frozen=True)
class Candidate:
    """Position examined as a possible marker, with the verdict.

    `centre_mm` is LPS. `accepted` candidates are the markers; for the others, and for a doubtful one that a
    person picked, `reason` says why not. `surface_share` [0..1] is the part of the sphere's surface found
    where it should be, `radius_mm` the fitted radius; both are None if no surface was found. `odds` [0..1] of
    a marker are 0 if no sphere of the size was found, and below even if it may not be a whole one.
    """

    centre_mm: tuple[float, float, float]
    accepted: bool
    reason: str
    contrast_hu: float
    surface_share: float | None = None
    radius_mm: float | None = None
    odds: float = 0.0

    @property
    def doubtful(self) -> bool:
        """Whether a sphere of the right size was fitted that may not be whole."""
        return 0.0 < self.odds < EVEN

    def describe(self) -> str:
        """Describe the candidate in one phrase: centre in LPS mm, reason, and the odds if doubtful."""
        x, y, z = self.centre_mm
        odds = f" (odds {self.odds:.2f})" if self.doubtful else ""
        return f"({x:z.1f}, {y:z.1f}, {z:z.1f}) {self.reason}{odds}"


def likeliest_first(candidates: Iterable[Candidate]) -> list[Candidate]:
    """Sort candidates: accepted first, then doubtful ones by odds, then the rest by surface share."""
    return sorted(candidates, key=lambda one: (not one.accepted, -one.odds, -(one.surface_share or 0.0)))


@dataclass(frozen=True)
class MarkerDoubt:
    """Reason why a candidate may not be a marker; an `excess` of 1 on its own means even odds."""

    reason: str
    excess: float


def odds(doubts: Iterable[MarkerDoubt]) -> float:
    """Combine doubts into odds [0..1] that a candidate is a marker; one doubt at its limit gives 0.5."""
    return float(np.prod([1.0 / (1.0 + doubt.excess**STEEPNESS) for doubt in doubts]))


def reasons(doubts: Iterable[MarkerDoubt]) -> str:
    """List the significant doubts in words, most serious first."""
    gravest = sorted(doubts, key=lambda doubt: -doubt.excess)
    return ", ".join(doubt.reason for doubt in gravest if doubt.excess > WORTH_TELLING)
