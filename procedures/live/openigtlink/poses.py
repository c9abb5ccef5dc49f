"""Poses of a running case as OpenIGTLink transforms, those in patient coordinates composed and in RAS.

A pose that is not valid keeps its last matrix, with its state as metadata: never zeros or identity.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from procedures.live.openigtlink.names import RAS_FROM_LPS, transform_name
from procedures.live.openigtlink.outgoing import Outgoing
from procedures.live.records import FramePose
from ronna_hw.devices.readings import Validity
from ronna_hw.frames import Frame
from ronna_hw.vectors import Quaternion
from ronna_hw.wire.openigtlink_contents import Matrix, encode_transform

TRANSFORM: Final = "TRANSFORM"
STATUS_WORDS: Final = {  # PLUS's words; every other validity is INVALID
    Validity.OK: "OK",
    Validity.MISSING: "MISSING",
    Validity.OUT_OF_VOLUME: "OUT_OF_VOLUME",
    Validity.STALE: "REQ_TIMEOUT",
}
# Child, frame between, parent; each may use the one before it.
COMPOSED: Final = ((Frame.TOOL, Frame.FLANGE, Frame.ROBOT), (Frame.TOOL, Frame.ROBOT, Frame.CT))


@dataclass(frozen=True, eq=False)
class Pose:
    """Last matrix of parent <- child and the state of the newest reading."""

    child: str
    parent: str
    matrix: Matrix
    validity: Validity
    stamp_ns: int
    is_fixed: bool

    @property
    def sent_matrix(self) -> Matrix:
        """Matrix as peers understand it: into patient coordinates it leads to RAS."""
        return RAS_FROM_LPS @ self.matrix if self.parent == Frame.CT else self.matrix

    def outgoing(self) -> Outgoing:
        """Return the transform as a message."""
        is_valid = self.validity is Validity.OK
        return Outgoing(
            TRANSFORM,
            transform_name(self.child, self.parent),
            encode_transform(self.sent_matrix),
            self.stamp_ns,
            {
                "TransformStatus": STATUS_WORDS.get(self.validity, "INVALID"),
                "TransformValid": "1" if is_valid else "0",
            },
            needs_metadata=not is_valid,
        )


class Poses:
    """All poses of a running case."""

    def __init__(self) -> None:
        self._latest: dict[tuple[str, str], Pose] = {}

    def take(self, record: FramePose, stamp_ns: int) -> list[Pose]:
        """Take a record and return the poses that it changes: its own, and those composed with it."""
        if (pose := self._read(record, stamp_ns)) is None:
            return []
        self._latest[pose.child, pose.parent] = pose
        return [pose, *self._composed_with(pose)]

    def _read(self, record: FramePose, stamp_ns: int) -> Pose | None:
        """Return the pose of a record, inverted if it is that of the CT; None before its first numbers."""
        child, parent = record.child, record.parent
        matrix: Matrix | None = None
        validity = record.validity
        is_valid = validity is Validity.OK
        if is_valid and record.rotation is not None and record.translation_mm is not None:
            matrix = rigid_matrix(record.rotation, record.translation_mm)
        if is_reversed := child == Frame.CT:
            child, parent = parent, child
        if matrix is None:
            if (last := self._latest.get((child, parent))) is None:
                return None
            matrix = last.matrix
            validity = Validity.MISSING if is_valid else validity
        elif is_reversed:
            matrix = invert(matrix)
        return Pose(child, parent, matrix, validity, stamp_ns, record.is_fixed)

    def _composed_with(self, changed: Pose) -> list[Pose]:
        """Return the composed poses that a change voids or renews, with the time of the moving part."""
        renewed = [changed]
        for child, middle, parent in COMPOSED:
            inner, outer = self._latest.get((child, middle)), self._latest.get((middle, parent))
            if inner is None or outer is None or not (inner in renewed or outer in renewed):
                continue
            doubts = [one.validity for one in (outer, inner) if one.validity is not Validity.OK]
            validity, *_ = (*doubts, Validity.OK)
            moving = outer if inner.is_fixed else inner
            stamp_ns = changed.stamp_ns if doubts else moving.stamp_ns
            pose = Pose(child, parent, outer.matrix @ inner.matrix, validity, stamp_ns, is_fixed=False)
            self._latest[child, parent] = pose
            renewed.append(pose)
        return renewed[1:]


def invert(rigid: Matrix) -> Matrix:
    """Return the inverse of a rigid matrix (4, 4)."""
    inverse = np.eye(4)
    inverse[:3, :3] = rigid[:3, :3].T
    inverse[:3, 3] = -rigid[:3, :3].T @ rigid[:3, 3]
    return inverse


def rigid_matrix(rotation: Quaternion, translation_mm: tuple[float, float, float]) -> Matrix:
    """Return the matrix (4, 4) of a unit quaternion, scalar first, and a translation."""
    w, x, y, z = rotation
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), translation_mm[0]],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), translation_mm[1]],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), translation_mm[2]],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
