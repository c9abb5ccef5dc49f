"""Data model of a plan: trajectories on a CT, for a patient position and a tool.

Strict: unknown keys are errors, and nothing that decides side or patient has a default.
"""

from __future__ import annotations

import math
from enum import StrEnum
from itertools import combinations
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from procedures.planning.ac_pc import AcPcFrame
from procedures.planning.errors import AcPcUnfit
from procedures.strategies.trajectory import Trajectory
from ronna_hw.calibration import Strict
from ronna_hw.marker_template import FEWEST, LEAST_DISTANCE_MM, MOST
from ronna_hw.notebook_html import table_html
from ronna_hw.plausible import LEAST_DEPTH_MM, MOST_DEPTH_MM, FreeAngle, Margin, TrajectoryName
from ronna_hw.x_frame import SPHERE_CENTRES_MM

SCHEMA_VERSION = 1
FEWEST_MARKERS, MOST_MARKERS = 3, 8
MOST_BESIDE_SKIN = 3  # with more, spheres alone are as accurate
MOST_TRAJECTORIES = 100  # ten times a large implantation of electrodes
UID_PATTERN = r"^[0-9]+(\.[0-9]+)+$"  # DICOM: numbers and dots, at most 64 characters
LONGEST_AUTHOR = 60
DIGEST_PATTERN = r"^[0-9a-f]{64}$"  # SHA-256
LEAST_STANDOFF_MM, MOST_STANDOFF_MM = -50.0, 100.0  # a value inside the skin is refused by its own check
MOST_STRUCTURES = 20
MOST_POINTS = 1000  # of one structure; a denser cloud is thinned, and the loss of accuracy recorded
MOST_POINTS_TOGETHER = 3000  # as many as a plan file has room for
LARGEST_STRUCTURE_MARGIN_MM = 30.0
STRUCTURE_NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9 _.-]*$"
NOT_METRES = "give millimetres, not metres"
HEAD_SPAN = 0.5  # metres: wider than any head
TABLE_TRAVEL = 2.0  # metres: how far a series may be from the scanner's origin
MOST_INSTRUMENT_MM = 500.0  # twice the longest biopsy needle
LARGEST_FUSION_ERROR_MM = 5.0  # ten times what a fusion may expect

Coordinate = Annotated[float, Field(allow_inf_nan=False, ge=-10_000.0, le=10_000.0)]
Point = tuple[Coordinate, Coordinate, Coordinate]


class PatientPosition(StrEnum):
    """Patient position in DICOM terms: head or feet first; supine, prone or on a side."""

    HFS = "HFS"
    HFP = "HFP"
    HFDR = "HFDR"
    HFDL = "HFDL"
    FFS = "FFS"
    FFP = "FFP"
    FFDR = "FFDR"
    FFDL = "FFDL"


# Upward direction, LPS, by the end of the position's name: supine, prone, on the right, on the left side.
UP_LPS = {"S": (0.0, -1.0, 0.0), "P": (0.0, 1.0, 0.0), "DR": (1.0, 0.0, 0.0), "DL": (-1.0, 0.0, 0.0)}


class FiducialKind(StrEnum):
    """Kind of fiducials: spheres on screws, the x-shaped frame, adhesive rings, or the surface of the head.

    `MIXED` is the surface with a few spheres on screws. Only the CT shows adhesive rings: a plan may name
    them, a case refuses it.
    """

    FREE = "free"
    XFRAME = "xframe"
    ADHESIVE = "adhesive"
    SURFACE = "surface"
    MIXED = "mixed"

    @property
    def has_skin(self) -> bool:
        """Whether the skin is registered, alone or with spheres."""
        return self in (FiducialKind.SURFACE, FiducialKind.MIXED)

    @property
    def fewest_and_most(self) -> tuple[int, int]:
        """Smallest and largest number of markers on the head."""
        on_skin = {FiducialKind.SURFACE: (0, 0), FiducialKind.MIXED: (1, MOST_BESIDE_SKIN)}
        return on_skin.get(self, (FEWEST_MARKERS, MOST_MARKERS))


class PlannedTrajectory(Strict):
    """Planned trajectory: entry and target in CT coordinates (LPS, mm), free angle, and margin.

    `margin_mm` is the target error that the surgeon accepts; with a larger predicted error the
    trajectory is refused.
    """

    id: TrajectoryName = Field(description="Its name.")
    entry_mm: Point = Field(description="Where it enters the head, LPS.")
    target_mm: Point = Field(description="Where it ends, LPS.")
    free_angle_deg: FreeAngle = Field(default=0.0, description="Angle of the guide about the axis.")
    margin_mm: Margin = Field(description="Largest accepted target error.")
    fusion_error_mm: float | None = Field(
        default=None,
        allow_inf_nan=False,
        gt=0.0,
        le=LARGEST_FUSION_ERROR_MM,
        description="Expected rms error of the fusion at the target, if it was chosen in the fused series.",
    )

    @model_validator(mode="after")
    def _check_depth(self) -> PlannedTrajectory:
        if self.depth_mm < LEAST_DEPTH_MM:
            raise PydanticCustomError(
                "trajectory_geometry",
                "entry and target are {depth} mm apart, expected at least {limit} mm{unit}",
                {
                    "depth": f"{self.depth_mm:.3g}",
                    "limit": f"{LEAST_DEPTH_MM:g}",
                    "unit": f": {NOT_METRES}" if is_in_metres((self.entry_mm, self.target_mm)) else "",
                },
            )
        if self.depth_mm > MOST_DEPTH_MM:
            raise PydanticCustomError(
                "trajectory_geometry",
                "the target at ({target}) mm is {depth} mm deep, limit {limit} mm",
                {
                    "target": ", ".join(f"{value:.1f}" for value in self.target_mm),
                    "depth": f"{self.depth_mm:.1f}",
                    "limit": f"{MOST_DEPTH_MM:g}",
                },
            )
        return self

    @property
    def depth_mm(self) -> float:
        """Distance from entry to target."""
        return math.dist(self.entry_mm, self.target_mm)

    @property
    def trajectory(self) -> Trajectory:
        """The trajectory in the form used by strategies, with the angle in radians."""
        return Trajectory(self.id, self.entry_mm, self.target_mm, math.radians(self.free_angle_deg))


class Structure(Strict):
    """Drawn or imported structure: points in CT coordinates (LPS, mm) and the margin to keep."""

    name: str = Field(min_length=1, max_length=32, pattern=STRUCTURE_NAME_PATTERN, description="Its name.")
    margin_mm: float = Field(
        allow_inf_nan=False,
        ge=0.0,
        le=LARGEST_STRUCTURE_MARGIN_MM,
        description="Minimum distance from a trajectory's axis; includes half the instrument's thickness.",
    )
    within_mm: float = Field(
        default=0.0,
        allow_inf_nan=False,
        ge=0.0,
        le=LARGEST_STRUCTURE_MARGIN_MM,
        description="Largest gap of its surface from the nearest listed point; subtracted "
        "from every distance.",
    )
    points_mm: Annotated[tuple[Point, ...], Field(min_length=1, max_length=MOST_POINTS)] = Field(
        description="Its points, LPS."
    )


class AcPcPoints(Strict):
    """Points that define the AC-PC frame, in CT coordinates (LPS, mm). They decide nothing in a case."""

    ac_mm: Point = Field(description="Centre of the anterior commissure.")
    pc_mm: Point = Field(description="Centre of the posterior commissure.")
    midline_mm: Point = Field(description="Point of the midline, at least 10 mm off the line through both.")

    @model_validator(mode="after")
    def _check_frame(self) -> AcPcPoints:
        try:
            AcPcFrame.from_points(self.ac_mm, self.pc_mm, self.midline_mm)
        except AcPcUnfit as unfit:
            raise PydanticCustomError("ac_pc_geometry", "{what}", {"what": unfit.summary}) from None
        return self


def _check_count(trajectories: tuple[PlannedTrajectory, ...]) -> tuple[PlannedTrajectory, ...]:
    # Not a length constraint on the field, whose message would suspect a decimal comma.
    if not 1 <= len(trajectories) <= MOST_TRAJECTORIES:
        raise ValueError(f"1 to {MOST_TRAJECTORIES} trajectories are needed, got {len(trajectories)}")
    return trajectories


class PlanFusion(Strict):
    """Fusion by which targets were chosen in another series than the CT."""

    series_instance_uid: str = Field(
        max_length=64, pattern=UID_PATTERN, description="DICOM UID of the series in which they were chosen."
    )
    modality: str = Field(min_length=1, max_length=16, description="Its DICOM modality, such as MR.")
    record_sha256: str = Field(
        pattern=DIGEST_PATTERN, description="Digest of the file that `ronna-ct fuse` wrote."
    )


class Seal(Strict):
    """Seal of a plan: author, and digests of CT and plan. An altered plan is rejected."""

    author: str = Field(min_length=1, max_length=LONGEST_AUTHOR, description="Who saved it, in the planner.")
    ct_sha256: str = Field(pattern=DIGEST_PATTERN, description="Digest of the CT it was made on.")
    plan_sha256: str = Field(pattern=DIGEST_PATTERN, description="Digest of the rest of the plan.")


class Plan(Strict):
    """Complete plan, as stored in `plan.toml`."""

    schema_version: Literal[1] = Field(alias="schema", description="Version of the file format.")
    series_instance_uid: str = Field(
        max_length=64, pattern=UID_PATTERN, description="DICOM UID of the CT series it was made on."
    )
    patient_orientation: PatientPosition = Field(description="Patient position in the scanner.")
    table_position: PatientPosition | None = Field(
        default=None, description="Patient position on the operating table, if not as in the scanner."
    )
    implanted: int = Field(
        ge=0,
        le=MOST_MARKERS,
        description="Markers on the head, 3 to 8; none with the surface as fiducial, 1 to 3 beside it.",
    )
    fiducials: FiducialKind = Field(
        description="Single spheres, the x-shaped frame, the head's surface alone or with spheres (mixed), "
        "or adhesive rings, with which no case begins."
    )
    template_mm: tuple[Point, ...] | None = Field(
        default=None,
        description="Centres of the template's spheres, in any frame, if they were implanted with one.",
    )
    tool: str = Field(min_length=1, max_length=64, description="Tool carried to the target.")
    standoff_mm: float = Field(
        allow_inf_nan=False,
        ge=LEAST_STANDOFF_MM,
        le=MOST_STANDOFF_MM,
        description="From the entry to the lower end of the guide, which is held outside the skin.",
    )
    instrument_length_mm: float = Field(
        allow_inf_nan=False,
        gt=0.0,
        le=MOST_INSTRUMENT_MM,
        description="Length of the instrument, from its tip to the end that still holds a depth stop.",
    )
    trajectories: Annotated[tuple[PlannedTrajectory, ...], AfterValidator(_check_count)] = Field(
        description="In the intended order."
    )
    structures: Annotated[tuple[Structure, ...], Field(min_length=1, max_length=MOST_STRUCTURES)] | None = (
        Field(default=None, description="Structures that the trajectories avoid.")
    )
    ac_pc: AcPcPoints | None = Field(
        default=None, description="Points of the AC-PC frame, if coordinates are read in it."
    )
    fusion: PlanFusion | None = Field(
        default=None, description="Fusion by which targets were chosen in another series, if any were."
    )
    seal: Seal | None = Field(
        default=None, description="Seal of the planner; remove it to edit the file by hand."
    )

    @model_validator(mode="after")
    def _check_implanted(self) -> Plan:
        fewest, most = self.fiducials.fewest_and_most
        if not fewest <= self.implanted <= most:
            raise PydanticCustomError(
                "implanted",
                "implanted: found {implanted}, expected {fewest} to {most} with fiducials {kind}",
                {"implanted": self.implanted, "kind": self.fiducials.value, "fewest": fewest, "most": most},
            )
        return self

    @model_validator(mode="after")
    def _check_frame(self) -> Plan:
        if self.fiducials is FiducialKind.XFRAME:
            spheres = len(SPHERE_CENTRES_MM)
            if self.implanted != spheres:
                raise PydanticCustomError(
                    "frame",
                    "the x-shaped frame has {spheres} spheres, {implanted} are implanted",
                    {"spheres": spheres, "implanted": self.implanted},
                )
            if self.template_mm is not None:
                raise PydanticCustomError(
                    "frame", "template_mm is for free spheres, not for the x-shaped frame"
                )
        return self

    @model_validator(mode="after")
    def _check_fusion(self) -> Plan:
        chosen = [one.id for one in self.trajectories if one.fusion_error_mm is not None]
        if chosen and self.fusion is None:
            raise PydanticCustomError(
                "fusion", "{ids}: fusion_error_mm needs the table [fusion]", {"ids": ", ".join(chosen)}
            )
        if self.fusion is not None and not chosen:
            raise PydanticCustomError(
                "fusion", "[fusion] needs fusion_error_mm in the trajectories that were chosen by it"
            )
        return self

    @model_validator(mode="after")
    def _check_template(self) -> Plan:
        if self.template_mm is None:
            return self
        count = len(self.template_mm)
        if not FEWEST <= count <= MOST or count != self.implanted:
            raise PydanticCustomError(
                "template",
                "template_mm has {count} spheres, {implanted} are implanted ({fewest} or {most})",
                {"count": count, "implanted": self.implanted, "fewest": FEWEST, "most": MOST},
            )
        if min(math.dist(a, b) for a, b in combinations(self.template_mm, 2)) < LEAST_DISTANCE_MM:
            raise PydanticCustomError("template", "two spheres of template_mm coincide")
        return self

    @model_validator(mode="after")
    def _check_structures(self) -> Plan:
        names = [one.name for one in self.structures or ()]
        if len(set(names)) < len(names):
            raise PydanticCustomError("structure", "two structures have the same name")
        points = sum(len(one.points_mm) for one in self.structures or ())
        if points > MOST_POINTS_TOGETHER:
            raise PydanticCustomError(
                "structure",
                "the structures have {points} points in total, limit {limit}",
                {"points": points, "limit": MOST_POINTS_TOGETHER},
            )
        return self

    def _repr_html_(self) -> str:
        """Return the trajectories as a notebook shows them, in LPS mm of the CT."""
        heads = ("trajectory", "entry_ct_mm", "target_ct_mm", "depth_mm", "margin_mm")
        rows = [
            (one.id, *map(np.array, (one.entry_mm, one.target_mm)), one.depth_mm, one.margin_mm)
            for one in self.trajectories
        ]
        caption = (
            f"{self.patient_orientation.value}; {self.implanted} spheres, {self.fiducials.value}; tool "
            f"{self.tool}; instrument {self.instrument_length_mm:g} mm; stand-off {self.standoff_mm:g} mm"
        )
        return table_html(heads, rows, len(rows), caption)

    @property
    def table_orientation(self) -> PatientPosition:
        """Patient position on the operating table."""
        return self.table_position or self.patient_orientation

    def trajectory(self, identifier: str) -> PlannedTrajectory:
        """Return the trajectory with this id; raises KeyError."""
        for one in self.trajectories:
            if one.id == identifier:
                return one
        raise KeyError(identifier)


def span(points: ArrayLike) -> float:
    """Return the bounding-box diagonal of points (n, 3), in their unit."""
    return float(np.linalg.norm(np.ptp(np.asarray(points, dtype=float), axis=0)))


def is_in_metres(points: ArrayLike) -> bool:
    """Return whether points (n, 3), given as millimetres, span so little that they must be in metres.

    One point alone, as drawn first, says nothing about its unit.
    """
    values = np.asarray(points, dtype=float)
    return len(values) > 1 and span(values) < HEAD_SPAN and float(np.abs(values).max()) < TABLE_TRAVEL
