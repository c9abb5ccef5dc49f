"""Named frames, and transforms that can be composed only across matching frames.

Lengths are millimetres, angles radians. `CT` is the patient frame of the series, DICOM LPS.
A `Transform(target, source, ...)` maps coordinates in `source` to coordinates in `target`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from ronna_hw.arguments import WrongArgument, show
from ronna_hw.arrays import Array
from ronna_hw.errors import DataError, ErrorCode

ROUNDING = 1e-6  # tolerance for being a rotation up to rounding


class Frame(StrEnum):
    """Coordinate frames of the theatre."""

    CT = "ct"  # patient coordinates of the series, LPS
    ROBOT = "robot"  # $ROBROOT of the arm, z up, x forward
    ASSISTANT = "assistant"  # $ROBROOT of the assistant; to its driver, as to that of any arm, it is ROBOT
    FLANGE = "flange"  # z out of the flange
    TOOL = "tool"  # tool centre point; z along the tool axis, towards the patient
    CAMERA_LEFT = "camera_left"  # z along the optical axis, x along image columns, y down
    CAMERA_RIGHT = "camera_right"
    TRACKER = "tracker"  # origin at the sensor, everything tracked has negative z
    MARKER = "marker"  # reference frame M on the tool, seen by the tracker
    PATIENT = "patient"  # reference frame on the head clamp, seen by the tracker


FRAME_MISMATCH = ErrorCode(
    "FRM-001",
    DataError,
    "Frames of composed transforms, or of a transform and its points, do not match.",
    "Check which frame each transform maps from and to; invert one of them if it is reversed.",
)


UNKNOWN_FRAME = ErrorCode(
    "FRM-002",
    DataError,
    "The name is not that of a frame.",
    "Name the frames as in Frame.ROBOT and Frame.CT, or by these words.",
)


def perpendicular_axes(direction: Array) -> tuple[Array, Array]:
    """Return two unit vectors perpendicular to a unit vector (3,) and to each other, right-handed with it."""
    across = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    across /= np.linalg.norm(across)
    return across, np.cross(direction, across)


def build_rigid(translation_mm: Array, rotation: Rotation) -> RigidTransform:
    """Build a rotation followed by a translation (3,) mm.

    Raises ValueError for other shapes, FRM-001 for non-finite numbers.

    `RigidTransform.from_components` multiplies two transforms and checks the product, which takes several
    times as long; planning builds tens of thousands.
    """
    matrix = np.eye(4)
    matrix[:3, :3] = turned = rotation.as_matrix()
    matrix[:3, 3] = np.reshape(translation_mm, 3)
    # A quaternion whose square overflows leaves a matrix of zeros.
    if not abs(float(np.vdot(turned, turned)) - 3.0) < ROUNDING or not np.isfinite(matrix).all():
        raise FRAME_MISMATCH(f"expected a finite translation and a rotation, got\n{matrix}")
    return RigidTransform(matrix, normalize=False, copy=False)


def _as_floats(given: ArrayLike, what: str) -> Array:
    try:
        return np.asarray(given, dtype=float)
    except (TypeError, ValueError) as error:
        raise WrongArgument(
            f"{what}: no array of numbers", expected="numbers in mm", got=show(given)
        ) from error


def is_rotation(matrix: Array) -> bool:
    """Return whether a finite matrix (3, 3) is a proper rotation up to rounding."""
    residual = matrix @ matrix.T - np.eye(3)
    return bool(np.abs(residual).max() <= ROUNDING and np.linalg.det(matrix) >= 0)


@dataclass(frozen=True)
class Transform:
    """Rigid transform `target <- source`, based on SciPy's `RigidTransform`.

    A frame may be given by its name, such as "ct". Raises FRM-002 for a name that is no frame.
    """

    target: Frame
    source: Frame
    rigid: RigidTransform

    def __post_init__(self) -> None:
        for name in ("target", "source"):
            given = getattr(self, name)
            if type(given) is Frame:
                continue
            try:
                object.__setattr__(self, name, Frame(given))
            except ValueError as error:
                raise UNKNOWN_FRAME(
                    "there is no such frame", expected=", ".join(Frame), got=repr(given)
                ) from error

    @classmethod
    def of(
        cls,
        target: Frame,
        source: Frame,
        *,
        translation_mm: ArrayLike = (0.0, 0.0, 0.0),
        quaternion_wxyz: ArrayLike = (1.0, 0.0, 0.0, 0.0),
    ) -> Self:
        """Build from a translation (3, mm) and a scalar-first quaternion (4), which is normalised.

        Raises ARG-001, FRM-001, FRM-002.
        """
        try:
            rotation = Rotation.from_quat(np.asarray(quaternion_wxyz, dtype=float), scalar_first=True)
        except ValueError as error:
            raise FRAME_MISMATCH(
                f"the quaternion {target} <- {source} is no rotation",
                expected="w, x, y, z, not all of them zero",
                got=f"{quaternion_wxyz!r}",
                action="Give a quaternion whose scalar part comes first.",
            ) from error
        translation = _as_floats(translation_mm, "the translation")
        if translation.size != 3:
            raise FRAME_MISMATCH(f"the translation has shape {translation.shape}", expected="(3,), mm")
        return cls(target, source, build_rigid(translation, rotation))

    @classmethod
    def from_matrix(cls, target: Frame, source: Frame, matrix: ArrayLike) -> Self:
        """Build from a (4, 4) homogeneous matrix in mm; the rotation block must be a proper rotation."""
        values = _as_floats(matrix, "the matrix")
        if values.shape != (4, 4) or not np.all(np.isfinite(values)):
            rows = np.flatnonzero(~np.isfinite(values).all(axis=-1)).tolist() if values.ndim == 2 else []
            raise FRAME_MISMATCH(
                f"a transform {target} <- {source} needs a finite 4x4 matrix",
                got=f"shape {values.shape}"
                if values.shape != (4, 4)
                else f"NaN or infinity in row {rows[0] + 1}",
                action="Give rotation and translation in mm, with 0, 0, 0, 1 in the last row.",
            )
        if not is_rotation(values[:3, :3]):
            raise FRAME_MISMATCH(
                f"the matrix {target} <- {source} is not a proper rotation",
                expected="orthogonal axes of length 1, determinant 1",
                got=f"determinant {np.linalg.det(values[:3, :3]):.6g}",
                action="Give a rotation without scale or mirroring.",
            )
        return cls(target, source, RigidTransform.from_matrix(values))

    def _repr_html_(self) -> str:
        """Return the matrix as a notebook shows it."""
        from ronna_hw.notebook_html import table_html  # not for device processes

        heads = ("x", "y", "z", "origin, mm")
        rows = self.as_matrix()[:3].tolist()
        return table_html(heads, rows, len(rows), f"{self.target} <- {self.source}")

    @property
    def translation_mm(self) -> Array:
        """Origin of the source in target coordinates, (3,) mm."""
        return np.asarray(self.rigid.translation, dtype=float)

    @property
    def quaternion_wxyz(self) -> Array:
        """Rotation as a scalar-first unit quaternion with non-negative scalar part, (4,)."""
        return np.asarray(self.rigid.rotation.as_quat(canonical=True, scalar_first=True), dtype=float)

    @property
    def rotation_matrix(self) -> Array:
        """Rotation block, (3, 3)."""
        return self.as_matrix()[:3, :3]

    def as_matrix(self) -> Array:
        """Homogeneous matrix, (4, 4), mm."""
        return np.asarray(self.rigid.as_matrix(), dtype=float)

    def apply(self, points_mm: ArrayLike) -> Array:
        """Map points (3,) or (n, 3) in mm from source to target. Raises ARG-001, FRM-001."""
        points = _as_floats(points_mm, "the points")
        if points.shape[-1:] != (3,) or points.ndim > 2:
            raise FRAME_MISMATCH(
                f"the points in {self.source} have shape {points.shape}",
                expected="(3,) or (n, 3)",
                action="Give one point a row, x, y, z in mm.",
            )
        return np.asarray(self.rigid.apply(points), dtype=float)

    def displace(self, by_mm: ArrayLike) -> Transform:
        """Shift the origin by (3,) mm in the target frame, keeping the rotation."""
        place_mm = self.translation_mm + np.asarray(by_mm, dtype=float)
        return Transform(self.target, self.source, build_rigid(place_mm, self.rigid.rotation))

    def inverse(self) -> Transform:
        """Return the transform source <- target."""
        return Transform(self.source, self.target, self.rigid.inv())

    def __matmul__(self, other: Transform) -> Transform:
        """`(a <- b) @ (b <- c)` is `a <- c`; raises FRM-001 when the inner frames differ."""
        if self.source is not other.target:
            raise FRAME_MISMATCH(
                f"cannot compose {self.target} <- {self.source} with {other.target} <- {other.source}"
            )
        # A product of two proper rotations is one: SciPy would check that, in twice the time.
        product = self.rigid.as_matrix() @ other.rigid.as_matrix()
        return Transform(self.target, other.source, RigidTransform(product, normalize=False, copy=False))
