"""Template of three or four markers on a head, told apart by distances: of jig, plan and scene."""

from __future__ import annotations

import json
import math
from itertools import combinations, pairwise
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, ValidationError, model_validator

from ronna_hw.bounded_input import read_toml
from ronna_hw.calibration import Strict
from ronna_hw.errors import ConfigurationError, ErrorCode
from ronna_hw.mistakes import count_mistakes

FEWEST, MOST = 3, 4  # with more, their number identifies them
LEAST_DISTANCE_MM = 15.0  # two 11.5 mm spheres, and a gap that a CT shows
UNIT_TOLERANCE = 1e-3
IMPLANTED_SIGMA_MM = 0.3  # per axis: a screw follows its jig to half a millimetre

Coordinate = Annotated[float, Field(allow_inf_nan=False, ge=-10_000.0, le=10_000.0)]
Point = tuple[Coordinate, Coordinate, Coordinate]


BAD_TEMPLATE = ErrorCode(
    "TPL-001",
    ConfigurationError,
    "The marker template is missing, is not TOML, or contains errors (all listed).",
    "Make one with `ronna-plan template`, or correct the lines named here.",
)


class TemplateMarker(Strict):
    """Marker sphere, given by its centre and the direction of its post."""

    centre_mm: Point = Field(
        description="Centre of the sphere, LPS of the CT on which the template was made."
    )
    post: Point = Field(description="Unit vector from the skull to the sphere, same axes.")

    @model_validator(mode="after")
    def _has_unit_post(self) -> Self:
        if abs(math.hypot(*self.post) - 1.0) > UNIT_TOLERANCE:
            raise ValueError(f"post is not a unit vector: its length is {math.hypot(*self.post):.3f}")
        return self


class MarkerTemplate(Strict):
    """Template of three or four markers."""

    schema_version: Annotated[Literal[1], Field(alias="schema")] = Field(
        default=1, description="Version of this file format."
    )
    markers: Annotated[tuple[TemplateMarker, ...], Field(min_length=FEWEST, max_length=MOST)] = Field(
        description="Markers, in no particular order."
    )

    @property
    def centres_mm(self) -> tuple[Point, ...]:
        """Centres of the spheres, mm."""
        return tuple(marker.centre_mm for marker in self.markers)

    @property
    def distances_mm(self) -> tuple[float, ...]:
        """Distances between all pairs of markers, mm, ascending."""
        return tuple(sorted(math.dist(first, other) for first, other in combinations(self.centres_mm, 2)))

    @property
    def least_difference_mm(self) -> float:
        """Smallest difference between two marker distances, mm."""
        return min(longer - shorter for shorter, longer in pairwise(self.distances_mm))

    @model_validator(mode="after")
    def _stand_apart(self) -> Self:
        if self.distances_mm[0] < LEAST_DISTANCE_MM:
            raise ValueError(
                f"two markers are {self.distances_mm[0]:.1f} mm apart, limit {LEAST_DISTANCE_MM:g} mm"
            )
        return self


def read_marker_template(path: Path) -> MarkerTemplate:
    """Read and validate a template; raises TPL-001 listing every mistake."""
    try:
        content = read_toml(path, BAD_TEMPLATE)
    except OSError as error:
        raise BAD_TEMPLATE(f"cannot read {path}: {error.strerror}") from error
    try:
        return MarkerTemplate.model_validate_json(json.dumps(content, default=str))
    except ValidationError as error:
        raise BAD_TEMPLATE(f"{path.name} has {count_mistakes(error)}") from error
