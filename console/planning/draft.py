"""Draft of a plan, its undo history, and the file for unsaved changes.

A draft may be incomplete; each change is a new value. Unsaved changes are kept next to the plan, so that
neither a crash nor Ctrl-C loses them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from procedures.imaging.markers import Marker, ScanDeformation
from procedures.planning.ac_pc import AcPcFrame, require_commissures
from procedures.planning.errors import UnsavedChanges
from procedures.planning.plan_model import SCHEMA_VERSION, FiducialKind, Plan, PlanFusion, Structure
from procedures.strategies.trajectory import Point
from ronna_hw.bounded_input import InputRefused, read_json_bytes
from ronna_hw.records import write_atomically

USUAL_MARGIN_MM = 2.0
USUAL_STANDOFF_MM = 30.0
MOST_STEPS_BACK = 200
LANDMARKS = ("AC", "PC", "midline")  # in the order in which they are clicked
OF_THE_CT = ("markers", "deformation")  # of a draft: found again, not stored
LARGEST_BYTES = 1_000_000  # the maximum number of structures in a plan needs a fifth


@dataclass(frozen=True)
class DraftTrajectory:
    """A trajectory in LPS. Endpoints not yet chosen are None."""

    identifier: str
    entry_mm: Point | None = None
    target_mm: Point | None = None
    free_angle_deg: float = 0.0
    margin_mm: float = USUAL_MARGIN_MM
    fusion_error_mm: float | None = None  # of a target chosen in a fused series

    @property
    def ends(self) -> tuple[Point, Point] | None:
        """Entry and target, or None unless both are chosen."""
        if self.entry_mm is None or self.target_mm is None:
            return None
        return self.entry_mm, self.target_mm

    @property
    def depth_mm(self) -> float | None:
        """Distance from entry to target in mm, or None if either is missing."""
        return None if self.ends is None else math.dist(*self.ends)


@dataclass(frozen=True)
class Draft:
    """Content of a future `plan.toml`, and the spheres counted as markers."""

    patient_orientation: str
    implanted: int
    fiducials: FiducialKind = FiducialKind.FREE
    template_mm: tuple[Point, ...] | None = None
    tool: str = "guide"
    standoff_mm: float = USUAL_STANDOFF_MM
    instrument_length_mm: float | None = None  # only stated on its packaging
    ways: tuple[DraftTrajectory, ...] = (DraftTrajectory("T1"),)
    structures: tuple[Structure, ...] = ()
    table_position: str = ""  # as in the scanner
    landmarks: tuple[Point, ...] = ()  # AC, PC and a point of the midline, as far as they are clicked
    fusion: PlanFusion | None = None  # by which targets were chosen, as the plan states it
    markers: tuple[Marker, ...] = ()
    deformation: ScanDeformation | None = None  # that the spheres of the CT show

    @classmethod
    def of(cls, plan: Plan) -> Draft:
        """Build a draft from a plan file. The spheres are added later, from the CT."""
        return cls(
            patient_orientation=plan.patient_orientation.value,
            implanted=plan.implanted,
            fiducials=plan.fiducials,
            template_mm=plan.template_mm,
            tool=plan.tool,
            standoff_mm=plan.standoff_mm,
            instrument_length_mm=plan.instrument_length_mm,
            ways=tuple(
                DraftTrajectory(
                    item.id,
                    item.entry_mm,
                    item.target_mm,
                    item.free_angle_deg,
                    item.margin_mm,
                    item.fusion_error_mm,
                )
                for item in plan.trajectories
            ),
            structures=plan.structures or (),
            fusion=plan.fusion,
            table_position=plan.table_position or "",
            landmarks=()
            if plan.ac_pc is None
            else (plan.ac_pc.ac_mm, plan.ac_pc.pc_mm, plan.ac_pc.midline_mm),
        )

    def without_ct(self) -> Draft:
        """Return the draft without what is found again in the CT."""
        return replace(self, markers=(), deformation=None)

    @property
    def ac_pc(self) -> AcPcFrame | None:
        """The AC-PC frame, or None until all three points are clicked."""
        return AcPcFrame.from_points(*self.landmarks) if len(self.landmarks) == len(LANDMARKS) else None

    def with_landmark(self, place_mm: Point) -> Draft:
        """Add AC, PC or the midline point, whichever is next; after all three begin anew.

        Raises PLAN-031 for points that do not give a frame.
        """
        known = () if len(self.landmarks) == len(LANDMARKS) else self.landmarks
        draft = replace(self, landmarks=(*known, place_mm))
        if len(draft.landmarks) > 1:
            require_commissures(*draft.landmarks[:2])
        if len(draft.landmarks) == len(LANDMARKS):
            AcPcFrame.from_points(*draft.landmarks)
        return draft

    @property
    def used_fusion(self) -> PlanFusion | None:
        """Fusion by which at least one target was chosen, if any."""
        return self.fusion if any(item.fusion_error_mm is not None for item in self.ways) else None

    def find_way(self, identifier: str) -> DraftTrajectory | None:
        return next((item for item in self.ways if item.identifier == identifier), None)

    def way(self, identifier: str) -> DraftTrajectory:
        if (way := self.find_way(identifier)) is None:
            raise KeyError(identifier)
        return way

    def with_way(self, identifier: str, way: DraftTrajectory) -> Draft:
        return replace(self, ways=tuple(way if item.identifier == identifier else item for item in self.ways))

    def with_new_way(self) -> tuple[Draft, str]:
        """Add a trajectory. Return the new draft and the name of the trajectory."""
        taken = {item.identifier for item in self.ways}
        name = next(name for k in range(1, len(taken) + 2) if (name := f"T{k}") not in taken)
        return replace(self, ways=(*self.ways, DraftTrajectory(name))), name

    def without_way(self, identifier: str) -> Draft:
        """Remove a trajectory. The last trajectory is emptied instead."""
        remaining = tuple(item for item in self.ways if item.identifier != identifier)
        return replace(self, ways=remaining or (DraftTrajectory("T1"),))

    def structure(self, name: str) -> Structure | None:
        """Return the structure with that name, or None if there is none."""
        return next((item for item in self.structures if item.name == name), None)

    def with_structure(self, structure: Structure) -> Draft:
        """Add a structure, replacing any of the same name."""
        if self.structure(structure.name) is None:
            return replace(self, structures=(*self.structures, structure))
        return replace(
            self,
            structures=tuple(structure if item.name == structure.name else item for item in self.structures),
        )

    def without_structure(self, name: str) -> Draft:
        return replace(self, structures=tuple(item for item in self.structures if item.name != name))

    def content(self, series_instance_uid: str) -> dict[str, Any]:
        """Return the content of a plan file, with complete trajectories only."""
        content: dict[str, Any] = {
            "schema": SCHEMA_VERSION,
            "series_instance_uid": series_instance_uid,
            "patient_orientation": self.patient_orientation,
            "implanted": self.implanted,
            "fiducials": self.fiducials.value,
            "tool": self.tool,
            "standoff_mm": self.standoff_mm,
            "trajectories": [
                {
                    "id": item.identifier,
                    "entry_mm": list(item.ends[0]),
                    "target_mm": list(item.ends[1]),
                    "free_angle_deg": item.free_angle_deg,
                    "margin_mm": item.margin_mm,
                    **({} if item.fusion_error_mm is None else {"fusion_error_mm": item.fusion_error_mm}),
                }
                for item in self.ways
                if item.ends is not None
            ],
        }
        if self.instrument_length_mm is not None:
            content["instrument_length_mm"] = self.instrument_length_mm
        if self.template_mm is not None:
            content["template_mm"] = [list(item) for item in self.template_mm]
        if self.table_position:
            content["table_position"] = self.table_position
        if self.used_fusion is not None:
            content["fusion"] = self.used_fusion.model_dump(mode="json")
        if self.structures:
            content["structures"] = [item.model_dump(mode="json") for item in self.structures]
        if len(self.landmarks) == len(LANDMARKS):
            content["ac_pc"] = {
                f"{name.lower()}_mm": list(place)
                for name, place in zip(LANDMARKS, self.landmarks, strict=True)
            }
        return content


class DraftHistory:
    """The current draft, with undo and redo."""

    def __init__(self, draft: Draft) -> None:
        self._past: list[Draft] = []
        self._future: list[Draft] = []
        self.now = draft

    def change(self, draft: Draft, *, continues: bool = False) -> None:
        """Apply a change. One that `continues` the previous change, as during a drag, is undone with it."""
        if draft == self.now:
            return
        if not continues or not self._past:
            self._past = [*self._past, self.now][-MOST_STEPS_BACK:]
        self._future = []
        self.now = draft

    def undo(self) -> None:
        if self._past:
            self._future.append(self.now)
            self.now = self._past.pop()

    def redo(self) -> None:
        if self._future:
            self._past.append(self.now)
            self.now = self._future.pop()

    def replace_all(self, by: Callable[[Draft], Draft]) -> None:
        """Apply a function to every draft in the history."""
        self._past = [by(item) for item in self._past]
        self._future = [by(item) for item in self._future]
        self.now = by(self.now)

    @property
    def can_undo(self) -> bool:
        return bool(self._past)

    @property
    def can_redo(self) -> bool:
        return bool(self._future)


@dataclass(frozen=True)
class Axis:
    """Direction from target to entry, as ring and arc angles of a stereotactic frame, in degrees.

    `azimuth_deg` in the axial plane, 0 to the patient's left, 90 to the back; `elevation_deg` above
    it, up to the crown.
    """

    azimuth_deg: float
    elevation_deg: float

    @classmethod
    def of(cls, entry_mm: Sequence[float], target_mm: Sequence[float]) -> Axis:
        remaining, back, up = (e - t for e, t in zip(entry_mm, target_mm, strict=True))
        return cls(
            math.degrees(math.atan2(back, remaining)),
            math.degrees(math.atan2(up, math.hypot(remaining, back))),
        )

    def entry_mm(self, target_mm: Point, depth_mm: float) -> Point:
        """Return the entry point at the given depth from the target."""
        azimuth, elevation = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        along = (
            math.cos(elevation) * math.cos(azimuth),
            math.cos(elevation) * math.sin(azimuth),
            math.sin(elevation),
        )
        x, y, z = (t + depth_mm * a for t, a in zip(target_mm, along, strict=True))
        return x, y, z


class _StoredDraft(BaseModel):
    """Stored form of a draft and its base plan, without the spheres, which are detected again."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    series_instance_uid: str
    plan_sha256: str  # of the file that it changes; empty for a new one
    patient_orientation: str
    implanted: int
    fiducials: FiducialKind
    template_mm: tuple[Point, ...] | None
    tool: str
    standoff_mm: float
    instrument_length_mm: float | None
    ways: tuple[DraftTrajectory, ...]
    structures: tuple[Structure, ...]
    table_position: str = ""
    landmarks: Annotated[tuple[Point, ...], Field(max_length=len(LANDMARKS))] = ()
    fusion: PlanFusion | None = None

    @model_validator(mode="after")
    def _check_landmarks(self) -> _StoredDraft:
        if len(self.landmarks) == len(LANDMARKS):
            AcPcFrame.from_points(*self.landmarks)
        return self


class UnsavedFile:
    """File of unsaved changes, stored next to the plan."""

    def __init__(self, plan: Path, series_instance_uid: str) -> None:
        self.path = plan.with_name(f"{plan.name}.unsaved")
        self._series = series_instance_uid
        self._is_ours = False  # written or adopted here

    def store_draft(self, draft: Draft, plan_sha256: str) -> None:
        """Store a draft based on the plan file with that digest. Raises OSError."""
        values = {name: getattr(draft, name) for name in Draft.__dataclass_fields__ if name not in OF_THE_CT}
        kept = _StoredDraft(series_instance_uid=self._series, plan_sha256=plan_sha256, **values)
        write_atomically(self.path, kept.model_dump_json(indent=1).encode())
        self._is_ours = True

    def forget(self) -> None:
        """Delete the file once there are no unsaved changes."""
        if self._is_ours:
            self.path.unlink(missing_ok=True)
        self._is_ours = False

    def restore(self, plan_sha256: str, draft: Draft) -> Draft | None:
        """Return the stored draft with the spheres of `draft`, or None if nothing is stored.

        Raises PLAN-029 for one of another plan or CT, or an unreadable one, which is set aside.
        """
        if not self.path.exists():
            return None
        try:
            kept = _StoredDraft.model_validate_json(read_json_bytes(self.path, LARGEST_BYTES))
        except (OSError, InputRefused, ValidationError):
            raise self._set_aside("cannot be read") from None
        if (kept.series_instance_uid, kept.plan_sha256) != (self._series, plan_sha256):
            raise self._set_aside("belong to another CT, or to an earlier version of the plan")
        self._is_ours = True
        values = {name: getattr(kept, name) for name in Draft.__dataclass_fields__ if name not in OF_THE_CT}
        return replace(draft, **values)

    def _set_aside(self, why: str) -> UnsavedChanges:
        aside = next(
            item
            for k in range(1, 1000)
            if not (item := self.path.with_name(f"{self.path.name}-{k}")).exists()
        )
        try:
            self.path.rename(aside)
        except OSError:
            aside = self.path
        return UnsavedChanges(
            f"unsaved changes {why}; they are kept in {aside.name}", action="Continue with the plan as it is."
        )
