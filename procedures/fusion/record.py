"""Record of a fusion: the pose CT <- other series, its expected error at any point, and its checks."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, Field, ValidationError
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.fusion.errors import FUSION_UNREADABLE
from ronna_hw.arrays import Array
from ronna_hw.bounded_input import InputRefused, read_bounded
from ronna_hw.calibration import UNIT_NORM_TOLERANCE, Numbers3, Numbers4, Strict
from ronna_hw.mistakes import describe_mistakes

LARGEST_FILE_BYTES = 100_000  # ten times a record
# Of the deviations of the parts: their common error, such as that of a shading in the whole series, cancels
# between them. (U) On 20 phantoms of `benchmarks/scans/fusion.py` the error was half of it, once all of it.
COMMON_FACTOR = 1.0
LEAST_ERROR_MM = 0.2  # (U) rms: what no part shows, such as a distortion at the target alone


def _check_unit(quaternion: Numbers4) -> Numbers4:
    if abs(math.hypot(*quaternion) - 1.0) > UNIT_NORM_TOLERANCE:
        raise ValueError("must be a unit quaternion")
    return quaternion


class FusedPose(Strict):
    """A rigid pose CT <- other series, both in DICOM patient coordinates (LPS, mm)."""

    translation_mm: Numbers3 = Field(description="Where the other series' origin is in the CT.")
    quaternion_wxyz: Annotated[Numbers4, AfterValidator(_check_unit)] = Field(
        description="Rotation as a unit quaternion, scalar first."
    )

    @classmethod
    def of(cls, pose: RigidTransform) -> FusedPose:
        """Record a pose."""
        quaternion = pose.rotation.as_quat(scalar_first=True, canonical=True).tolist()
        return cls(translation_mm=tuple(pose.translation.tolist()), quaternion_wxyz=tuple(quaternion))

    @property
    def rigid(self) -> RigidTransform:
        """The pose for computations."""
        rotation = Rotation.from_quat(self.quaternion_wxyz, scalar_first=True)
        return RigidTransform.from_components(self.translation_mm, rotation)


class LandmarkCheck(Strict):
    """Landmarks that a person gave in both series."""

    count: int = Field(description="Number of pairs.")
    rms_mm: float = Field(description="Rms distance of the pairs after the registration.")
    largest_mm: float = Field(description="Largest distance of a pair.")


class Fusion(Strict):
    """Registration of another series to a CT, as stored by `ronna-ct fuse`."""

    schema_version: Literal[1] = Field(default=1, alias="schema", description="Version of the file format.")
    ct_series_uid: str = Field(description="DICOM UID of the CT series.")
    other_series_uid: str = Field(description="DICOM UID of the series registered to it.")
    other_frame_uid: str = Field(description="DICOM UID of that series' frame of reference.")
    modality: str = Field(min_length=1, max_length=16, description="DICOM modality of that series.")
    ct_from_other: FusedPose = Field(description="Pose CT <- other series.")
    parts: tuple[FusedPose, ...] = Field(
        min_length=2, description="The same by each part of the head alone; they show the error."
    )
    expected_mm: float = Field(description="Expected rms error within the head.")
    starts: int = Field(description="Number of starting poses.")
    agreeing_starts: int = Field(description="Starting poses that led to this result.")
    information: float = Field(description="Mutual information, in nats.")
    overlap: float = Field(description="Share of the CT's head that the other series shows.")
    landmarks: LandmarkCheck | None = Field(default=None, description="Landmarks, if a person gave some.")

    def map_to_ct(self, points_mm: ArrayLike) -> Array:
        """Map points (..., 3) mm of the other series into the CT."""
        points = np.asarray(points_mm, dtype=float)
        return np.asarray(self.ct_from_other.rigid.apply(points.reshape(-1, 3)).reshape(points.shape))

    def expect_error_mm(self, ct_point_mm: ArrayLike) -> float:
        """Return the expected rms error at a point (3,) mm of the CT."""
        return float(expect_errors_mm(self.ct_from_other, self.parts, np.reshape(ct_point_mm, (1, 3)))[0])


def expect_errors_mm(whole: FusedPose, parts: tuple[FusedPose, ...], ct_points_mm: Array) -> Array:
    """Return the expected rms error (n,) mm at points (n, 3) mm of the CT, by how far the parts deviate."""
    there = whole.rigid.inv().apply(ct_points_mm)
    squares = [np.square(one.rigid.apply(there) - ct_points_mm).sum(axis=1) for one in parts]
    return np.asarray(np.sqrt(COMMON_FACTOR**2 * np.mean(squares, axis=0) + LEAST_ERROR_MM**2))


def format_fusion(fusion: Fusion) -> bytes:
    """Format a fusion as JSON."""
    return (fusion.model_dump_json(by_alias=True, indent=1) + "\n").encode()


def read_fusion(path: Path, ct_series_uid: str) -> tuple[Fusion, str]:
    """Read a fusion with this CT; return it with the SHA-256 of its file. Raises FUS-007."""
    try:
        content = read_bounded(path, LARGEST_FILE_BYTES)
        fusion = Fusion.model_validate_json(content)
    except OSError as error:
        raise FUSION_UNREADABLE(f"cannot read {path}: {error.strerror}") from error
    except InputRefused as error:
        raise FUSION_UNREADABLE(f"{path.name} is refused: {error.summary}") from error
    except ValidationError as error:
        mistakes = "; ".join(describe_mistakes(error, Fusion))
        raise FUSION_UNREADABLE(f"{path.name} is not a fusion: {mistakes}") from error
    if fusion.ct_series_uid != ct_series_uid:
        raise FUSION_UNREADABLE(
            f"{path.name} belongs to another CT series", expected=ct_series_uid, got=fusion.ct_series_uid
        )
    return fusion, hashlib.sha256(content).hexdigest()


def format_itk_transform(fusion: Fusion) -> str:
    """Format an ITK transform file, with which 3D Slicer shows the other series in the CT's coordinates.

    ITK's direction: it maps points of the CT to those of the other series, LPS.
    """
    other_from_ct = fusion.ct_from_other.rigid.inv()
    numbers = (*other_from_ct.rotation.as_matrix().ravel().tolist(), *other_from_ct.translation.tolist())
    return (
        "#Insight Transform File V1.0\n#Transform 0\nTransform: AffineTransform_double_3_3\n"
        f"Parameters: {' '.join(format(value, '.17g') for value in numbers)}\nFixedParameters: 0 0 0\n"
    )
