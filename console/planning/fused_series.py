"""Series fused with the CT of a plan: its voxels in the CT's coordinates, and targets chosen in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from pathlib import Path

from console.planning.draft import Draft, DraftTrajectory
from procedures.fusion.chequerboard import find_grey_limits
from procedures.fusion.errors import OTHER_FUSION
from procedures.fusion.record import Fusion, read_fusion
from procedures.imaging import read_other_series
from procedures.imaging.volume import Volume, VoxelGeometry
from procedures.planning.plan_model import PlanFusion
from procedures.strategies.trajectory import Point

SECOND_CT = "second CT"  # its modality alone would not tell it from the CT of the plan


class ShownSeries(StrEnum):
    """Series that the pictures of a page show."""

    CT = "ct"
    OTHER = "other"
    BOTH = "both"  # as a chequerboard


@dataclass(frozen=True, eq=False)
class FusedSeries:
    """Series in the CT's coordinates, with its fusion and the table `[fusion]` of plans that refer to it."""

    volume: Volume
    fusion: Fusion
    reference: PlanFusion

    @classmethod
    def of(cls, other: Volume, fusion: Fusion, record_sha256: str) -> FusedSeries:
        """Move a series into the CT's coordinates by its fusion. Raises FUS-009 for another series."""
        if other.series_instance_uid != fusion.other_series_uid:
            raise OTHER_FUSION(
                "the series is not the one that was fused",
                expected=fusion.other_series_uid,
                got=other.series_instance_uid,
            )
        pose, there = fusion.ct_from_other.rigid, other.geometry
        moved = VoxelGeometry(
            there.shape,
            pose.apply(there.origin_mm),
            pose.rotation.as_matrix() @ there.axes,
            there.spacing_mm,
        )
        reference = PlanFusion(
            series_instance_uid=fusion.other_series_uid,
            modality=fusion.modality,
            record_sha256=record_sha256,
        )
        return cls(replace(other, geometry=moved), fusion, reference)

    @property
    def name(self) -> str:
        """Name of the series on a page."""
        return name_series(self.reference)

    @cached_property
    def grey_limits(self) -> tuple[float, float]:
        """Values shown black and white."""
        return find_grey_limits(self.volume)

    def with_target(self, draft: Draft, way: DraftTrajectory, target_mm: Point) -> Draft:
        """Return the draft with this target of a trajectory, marked as chosen in this series."""
        error_mm = round(self.fusion.expect_error_mm(target_mm), 3)
        marked = replace(way, target_mm=target_mm, fusion_error_mm=error_mm)
        return replace(draft.with_way(way.identifier, marked), fusion=self.reference)

    def require_own_targets(self, draft: Draft) -> None:
        """Raise FUS-009 if targets of the draft were chosen by another fusion."""
        if draft.used_fusion not in (None, self.reference):
            raise OTHER_FUSION("the plan's targets were chosen by another fusion; the plan is left unchanged")


def name_series(reference: PlanFusion | None) -> str:
    """Name the series in which targets were chosen."""
    if reference is None:
        return "fused series"
    return SECOND_CT if reference.modality == "CT" else reference.modality


def read_fused_series(
    record: Path, folder: Path, ct_series_uid: str, progress: Callable[[float], None]
) -> FusedSeries:
    """Read a fusion with this CT, and the series that it fuses. Raises FUS-007, FUS-009."""
    fusion, digest = read_fusion(record, ct_series_uid)
    other, _ = read_other_series(folder, progress=progress)
    return FusedSeries.of(other, fusion, digest)
