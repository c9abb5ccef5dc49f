"""Look at the room with the arms at rest: each body that the tracker sees, with its covariance.

A look keeps the whole pose of each frame and every known sphere, in the frame that the tracker had at the
localization. It is plain data: the journal keeps it, and a resumed case restores its estimate from there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from procedures.registration.rigid_fit import pose_jacobian
from ronna_hw.arrays import Array
from ronna_hw.vectors import JointVector, joint_vector

# One marker in one frame, per axis of the tracker, across and along its line of sight. (U)
# Safety against a moved head or cart within the tracker's own error.
MARKER_NOISE_MM = np.array([0.06, 0.06, 0.20])

NOISE_WORTH = 30  # frames that the stated noise counts as, beside the scatter of the frames themselves
# Safety against a moved head or cart within the tracker's own error.
FLOOR_MM = np.array([0.006, 0.006, 0.012])  # per axis, below which no number of frames brings a mean (U)
# A marker of a frame beside its place in the definition, per axis: with one hidden, the pose is another. (U)
# Safety against a moved head within what a hidden marker changes.
SEATING_MM = 0.05


class Tracked(StrEnum):
    """Frame that the tracker sees as one body."""

    ARM = "arm"  # on the mount of the arm with the guide
    ASSISTANT = "assistant"  # on the flange of the second arm
    CLAMP = "clamp"  # on the head clamp: the patient's frame


@dataclass(frozen=True)
class SeenFrame:
    """Mean pose of a tracked frame: place (3,) mm and rotation (3, 3), tracker frame.

    `covariance` (6, 6) is of the place (mm), then of a rotation vector (rad) about the tracker's axes;
    `markers_mm` (m, 3) are its markers at that pose, `shares` (m,) the share of frames that each was used in.
    """

    place_mm: Array
    rotation: Array
    covariance: Array
    markers_mm: Array
    shares: Array

    @property
    def pose(self) -> Array:
        """Pose (4, 4), tracker frame."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.place_mm
        return matrix


FRAME_SHAPES = {
    "place_mm": (3,),
    "rotation": (3, 3),
    "covariance": (6, 6),
    "markers_mm": (-1, 3),
    "shares": (-1,),
}


@dataclass(frozen=True)
class SeenSpheres:
    """Mean places (n, 3) mm of known spheres by number, with covariances (n, 3, 3), tracker frame."""

    numbers: tuple[int, ...] = ()
    places_mm: Array = field(default_factory=lambda: np.empty((0, 3)))
    covariances_mm2: Array = field(default_factory=lambda: np.empty((0, 3, 3)))


@dataclass(frozen=True)
class Rest:
    """Joints of an arm at rest, and on which side of its backlash each of them rests, None if unknown.

    `motions` is how many motions it has made: two looks between which it has not moved share what its arrival
    errs. None for a look that shares it with no other.
    """

    joints_rad: JointVector
    sides: tuple[int, ...] | None = None
    motions: int | None = None


@dataclass(frozen=True)
class Sighting:
    """One look at the room, with the arms at rest.

    `arms` are named by the frames on them. `tracker` and `head` count the pushes of the tracker and the moves
    of the head that were followed before.
    """

    arms: Mapping[Tracked, Rest]
    spheres: SeenSpheres = field(default_factory=SeenSpheres)
    frames: Mapping[Tracked, SeenFrame] = field(default_factory=dict)
    tracker: int = 0
    head: int = 0

    def as_plain(self) -> dict[str, Any]:
        """Return plain values for the journal."""
        return {
            "arms": {name.value: asdict(arm) for name, arm in self.arms.items()},
            "spheres": [
                {"number": number, "place_mm": place, "covariance_mm2": covariance}
                for number, place, covariance in zip(
                    self.spheres.numbers,
                    self.spheres.places_mm.tolist(),
                    self.spheres.covariances_mm2.tolist(),
                    strict=True,
                )
            ],
            "frames": {
                name.value: {part: getattr(seen, part).tolist() for part in FRAME_SHAPES}
                for name, seen in self.frames.items()
            },
            "tracker": self.tracker,
            "head": self.head,
        }

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> Self:
        """Read a look back from the journal. Raises LookupError, TypeError or ValueError if malformed."""
        spheres = plain["spheres"]
        return cls(
            {
                Tracked(name): Rest(
                    joint_vector(float(angle) for angle in one["joints_rad"]),
                    None if one["sides"] is None else tuple(int(side) for side in one["sides"]),
                    None if one["motions"] is None else int(one["motions"]),
                )
                for name, one in plain["arms"].items()
            },
            SeenSpheres(
                tuple(int(one["number"]) for one in spheres),
                _array([one["place_mm"] for one in spheres], (len(spheres), 3)),
                _array([one["covariance_mm2"] for one in spheres], (len(spheres), 3, 3)),
            ),
            {
                Tracked(name): SeenFrame(
                    **{part: _array(one[part], FRAME_SHAPES[part]) for part in FRAME_SHAPES}
                )
                for name, one in plain["frames"].items()
            },
            int(plain["tracker"]),
            int(plain["head"]),
        )


def average_frame(
    poses: Sequence[tuple[ArrayLike, ArrayLike]], markers_mm: ArrayLike, shares: Array
) -> SeenFrame:
    """Average poses (quaternion w, x, y, z; place (3,) mm) of a frame with markers (m, 3) mm of its own.

    `shares` (m,) are the shares of the poses that were fitted to each marker.
    """
    quaternions, places = (np.array(values, dtype=float) for values in zip(*poses, strict=True))
    rotations = Rotation.from_quat(quaternions, scalar_first=True)
    rotation, place_mm = rotations.mean(), places.mean(axis=0)
    deviations = np.hstack([places - place_mm, (rotations * rotation.inv()).as_rotvec()])
    offsets_mm = rotation.apply(np.asarray(markers_mm, dtype=float))
    stated, floor = (_of_frame(offsets_mm, shares, size_mm) for size_mm in (MARKER_NOISE_MM, FLOOR_MM))
    beside = marker_pull(offsets_mm, shares) - marker_pull(offsets_mm)
    seating = SEATING_MM**2 * np.asarray((beside @ beside.transpose(0, 2, 1)).sum(axis=0))
    covariance = _of_mean(deviations.T @ deviations, len(deviations), stated) + floor + seating
    return SeenFrame(place_mm, rotation.as_matrix(), covariance, place_mm + offsets_mm, shares)


def mean_covariance(scatter_mm2: Array, count: int) -> Array:
    """Return the covariance (3, 3) of the mean of `count` readings of a sphere with this scatter (3, 3)."""
    scatter = (count - 1) * scatter_mm2
    return _of_mean(scatter, count, np.diag(MARKER_NOISE_MM**2)) + np.diag(FLOOR_MM**2)


def expect_frame(place_mm: Array, rotation: Array, markers_mm: ArrayLike, frames: int) -> SeenFrame:
    """Return a frame as a look of that many frames is expected to show it, by the stated noise."""
    offsets_mm = np.asarray(markers_mm, dtype=float) @ rotation.T
    shares = np.ones(len(offsets_mm))
    noise, floor = (_of_frame(offsets_mm, shares, size_mm) for size_mm in (MARKER_NOISE_MM, FLOOR_MM))
    return SeenFrame(place_mm, rotation, noise / frames + floor, place_mm + offsets_mm, shares)


def expect_spheres(places_mm: Array, frames: int) -> SeenSpheres:
    """Return all spheres (n, 3) as a look of that many frames is expected to show them."""
    covariance = np.diag(MARKER_NOISE_MM**2 / frames + FLOOR_MM**2)
    return SeenSpheres(tuple(range(len(places_mm))), places_mm, np.tile(covariance, (len(places_mm), 1, 1)))


def marker_pull(offsets_mm: Array, shares: Array | None = None) -> Array:
    """Return how a frame's pose, place then rotation, follows displacements of its markers, (m, 6, 3).

    `offsets_mm` (m, 3) are the markers from the frame's origin, `shares` (m,) by how much each counts, by
    default all alike. The tracker fits the pose by least squares.
    """
    jacobian = pose_jacobian(offsets_mm, np.zeros(3))[..., [3, 4, 5, 0, 1, 2]]
    towards = (
        jacobian.transpose(0, 2, 1) * (np.ones(len(offsets_mm)) if shares is None else shares)[:, None, None]
    )
    return np.asarray(np.linalg.inv((towards @ jacobian).sum(axis=0)) @ towards)


def _of_frame(offsets_mm: Array, shares: Array, marker_mm: Array) -> Array:
    """Return the covariance (6, 6) of a pose by that of its markers, averaged over where each is used."""
    pull = marker_pull(offsets_mm, shares)[shares > 0.0]
    rare = 1.0 / shares[shares > 0.0]
    return np.asarray(((pull * marker_mm**2 * rare[:, None, None]) @ pull.transpose(0, 2, 1)).sum(axis=0))


def _of_mean(squares: Array, count: int, stated: Array) -> Array:
    """Return the covariance of a mean from the sum of squared deviations and the stated noise."""
    return np.asarray((squares + NOISE_WORTH * stated) / (NOISE_WORTH + count - 1) / count)


def _array(values: Any, shape: tuple[int, ...]) -> Array:
    array = np.asarray(values, dtype=float).reshape(shape)
    if not np.isfinite(array).all():
        raise ValueError("expected finite numbers")
    return array
