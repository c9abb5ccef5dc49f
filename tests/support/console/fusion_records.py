"""Records of a fusion as `ronna-ct fuse` writes them, without the minute that it takes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from painted_ct import SERIES_UID, write_series
from pydicom.dataset import Dataset
from pydicom.uid import MRImageStorage
from scipy.spatial.transform import RigidTransform

from procedures.fusion.record import FusedPose, Fusion, format_fusion

MR_UID = "1.2.840.5"


def fusion(
    pose: RigidTransform | None = None,
    *,
    ct_uid: str = SERIES_UID,
    other_uid: str = MR_UID,
    deviation_mm: float = 0.3,
) -> Fusion:
    """A fusion with an MR by this pose CT <- MR; two halves deviate from it by so much to either side."""
    pose = RigidTransform.identity() if pose is None else pose
    shifts = [RigidTransform.from_translation((shift, 0.0, 0.0)) for shift in (deviation_mm, -deviation_mm)]
    return Fusion(
        schema=1,
        ct_series_uid=ct_uid,
        other_series_uid=other_uid,
        other_frame_uid="1.2.3",
        modality="MR",
        ct_from_other=FusedPose.of(pose),
        parts=tuple(FusedPose.of(shift * pose) for shift in shifts),
        expected_mm=0.37,
        starts=7,
        agreeing_starts=7,
        information=0.8,
        overlap=1.0,
    )


def write_fused_mr(folder: Path, record: Fusion | None = None) -> tuple[str, Path, str, Path]:
    """Write a small bright MR and a fusion with it; return the options that show it in the planner."""

    def as_mr(data: Dataset, _number: int) -> None:
        data.Modality, data.SeriesInstanceUID = "MR", MR_UID
        data.SOPClassUID = data.file_meta.MediaStorageSOPClassUID = MRImageStorage

    write_series(folder / "mr", np.full((20, 20, 20), 500, np.int16), (3.0, 3.0, 3.0), edit=as_mr)
    file = folder / "fused.json"
    file.write_bytes(format_fusion(record or fusion()))
    return "--fusion", file, "--other", folder / "mr"
