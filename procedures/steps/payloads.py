"""Poses and points in records: plain numbers there, checked transforms here."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ronna_hw.frames import Frame, Transform

Array = NDArray[np.float64]


def pose_payload(pose: Transform) -> dict[str, Any]:
    """A transform as plain numbers, with its frames."""
    return {
        "target": pose.target.value,
        "source": pose.source.value,
        "translation_mm": pose.translation_mm.tolist(),
        "quaternion_wxyz": pose.quaternion_wxyz.tolist(),
    }


def pose_from(payload: dict[str, Any]) -> Transform:
    """The transform that `pose_payload` wrote."""
    return Transform.of(
        Frame(payload["target"]),
        Frame(payload["source"]),
        translation_mm=payload["translation_mm"],
        quaternion_wxyz=payload["quaternion_wxyz"],
    )


def points_payload(points_mm: ArrayLike) -> list[list[float]]:
    """Points (n, 3) as plain numbers."""
    values: list[list[float]] = np.asarray(points_mm, dtype=float).reshape(-1, 3).tolist()
    return values


def points_from(payload: Any) -> Array:
    """Points (n, 3) from plain numbers."""
    return np.asarray(payload, dtype=float).reshape(-1, 3)
