"""Unsaved changes: kept next to the plan so that neither a crash nor Ctrl-C loses them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from console.planning.draft import Draft, Way
from procedures.planning.errors import UnsavedChanges
from procedures.planning.plan_model import FiducialKind, Structure
from procedures.strategies.trajectory import Point
from ronna_hw.bounded_input import InputRefused, read_json_bytes
from ronna_hw.records import write_whole

LARGEST_BYTES = 1_000_000  # the maximum number of structures in a plan needs a fifth


class _Kept(BaseModel):
    """A draft without its spheres, which are found again, and what it was based on."""

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
    ways: tuple[Way, ...]
    structures: tuple[Structure, ...]
    table_position: str = ""


class UnsavedFile:
    """The file next to a plan that stores its unsaved changes."""

    def __init__(self, plan: Path, series_instance_uid: str) -> None:
        self.path = plan.with_name(f"{plan.name}.unsaved")
        self._series = series_instance_uid
        self._is_ours = False  # written or adopted here

    def keep(self, draft: Draft, plan_sha256: str) -> None:
        """Store a draft that changes the plan file with that digest. Raises OSError."""
        values = {name: getattr(draft, name) for name in Draft.__dataclass_fields__ if name != "markers"}
        kept = _Kept(series_instance_uid=self._series, plan_sha256=plan_sha256, **values)
        write_whole(self.path, kept.model_dump_json(indent=1).encode())
        self._is_ours = True

    def forget(self) -> None:
        """We have no unsaved changes."""
        if self._is_ours:
            self.path.unlink(missing_ok=True)
        self._is_ours = False

    def take_up(self, plan_sha256: str, draft: Draft) -> Draft | None:
        """The stored draft, with the spheres of `draft`; None without one.

        Raises PLAN-029 for one of another plan or CT, or an unreadable one, which is set aside.
        """
        if not self.path.exists():
            return None
        try:
            kept = _Kept.model_validate_json(read_json_bytes(self.path, LARGEST_BYTES))
        except (OSError, InputRefused, ValidationError):
            raise self._put_aside("cannot be read") from None
        if (kept.series_instance_uid, kept.plan_sha256) != (self._series, plan_sha256):
            raise self._put_aside("belong to another CT, or to an earlier version of the plan")
        self._is_ours = True
        values = {name: getattr(kept, name) for name in Draft.__dataclass_fields__ if name != "markers"}
        return replace(draft, **values)

    def _put_aside(self, why: str) -> UnsavedChanges:
        aside = next(
            one for k in range(1, 1000) if not (one := self.path.with_name(f"{self.path.name}-{k}")).exists()
        )
        try:
            self.path.rename(aside)
        except OSError:
            aside = self.path
        return UnsavedChanges(
            f"unsaved changes {why}; they are kept in {aside.name}", action="Continue with the plan as it is."
        )
