"""Wrappers that call user methods and check that every answer is valid for its kind.

Arguments cannot be modified, and errors are reported with their line. Strategies are in `strategy`.
"""

from __future__ import annotations

import contextlib
import random
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from procedures.imaging.errors import MarkerCountWrong
from procedures.imaging.volume import Volume
from ronna_hw.arrays import Array
from studies.errors import MethodAnswerWrong, MethodFailed
from studies.plugins.method import PluginMethod

GLOBAL_SEED = 0
REAL = "iuf"  # NumPy's kinds: whole numbers, with or without a sign, and floating point
IN_WORDS = {"U": "text", "S": "bytes", "c": "complex numbers", "b": "truth values"}
Pairs = NDArray[np.intp]
BESIDE_MM = 10.0  # outside the volume: the centre of a sphere cut by the field of view
ROTATION_TOLERANCE = 1e-6  # on the products of a rotation's columns: 0.1 µm over a head


@dataclass(frozen=True)
class CheckedPlugin:
    """A named user method loaded in this process. `result` and `form` describe the required answer."""

    name: str
    function: Callable[..., Any]
    result: ClassVar[str]
    form: ClassVar[str]

    @classmethod
    def of(cls, method: PluginMethod) -> Self:
        """Load the method into this process. Raises STU-012."""
        return cls(method.name, method.function())

    def _as_numbers(self, answer: object) -> Array:
        """Convert an answer to an array. Raises STU-014 unless it consists of real numbers."""
        try:
            converted = np.asarray(answer)
        except (TypeError, ValueError, OverflowError):  # such as rows of unequal length
            raise self._wrong_answer(type(answer).__name__) from None
        if converted.size == 0:
            return np.empty(converted.shape)
        if converted.dtype.kind not in REAL:
            raise self._wrong_answer(IN_WORDS.get(converted.dtype.kind, type(answer).__name__))
        return converted.astype(float)

    def _wrong_answer(self, got: str) -> MethodAnswerWrong:
        return MethodAnswerWrong(f"{self.name} did not return {self.result}", expected=self.form, got=got)


class PluginPairing(CheckedPlugin):
    """User pairing method, called like `Pairing`; raises STU-013 and STU-014."""

    result = "a pairing"
    form = "None, or whole numbers (k, 2): indices from 0 of image and physical points, each point once"

    def __call__(
        self, image_mm: Array, physical_mm: Array, *, sigma_image_mm: float, sigma_physical_mm: float
    ) -> Pairs | None:
        """Return the pairs (k, 2), or None without a unique answer."""
        answer = call_plugin(
            self.name,
            self.function,
            image_mm,
            physical_mm,
            sigma_image_mm=sigma_image_mm,
            sigma_physical_mm=sigma_physical_mm,
        )
        if answer is None:
            return None
        try:
            pairs = np.asarray(answer)
        except ValueError:  # rows of unequal length
            pairs = np.asarray(None)
        if pairs.size == 0 and pairs.dtype != object:
            return np.empty((0, 2), dtype=np.intp)
        if pairs.dtype.kind not in "iu" or pairs.ndim != 2 or pairs.shape[1] != 2:
            raise self._wrong_answer(f"{type(answer).__name__} of {pairs.dtype}, shape {pairs.shape}")
        for side, points in enumerate((image_mm, physical_mm)):
            of_side = pairs[:, side]
            if of_side.min() < 0 or of_side.max() >= len(points):
                raise self._wrong_answer(f"index {of_side.max()} of {len(points)} points")
            if len(set(of_side.tolist())) < len(of_side):
                raise self._wrong_answer("a point in two pairs")
        return pairs.astype(np.intp)


class PluginLocalizer(CheckedPlugin):
    """User localizer, called like `Localizer`; raises STU-013 and STU-014."""

    result = "centres"
    form = "numbers (n, 3): patient coordinates LPS in mm, as returned by volume.geometry.to_patient_mm"

    def __call__(self, volume: Volume) -> Array:
        """Return centres (n, 3) in LPS mm."""
        try:
            answer = call_plugin(self.name, self.function, volume, passed=(MarkerCountWrong,))
        except MarkerCountWrong:  # how our localizer says that there are none
            return np.empty((0, 3))
        centres_mm = self._as_numbers(answer)
        if centres_mm.size == 0:
            return np.empty((0, 3))
        if centres_mm.ndim != 2 or centres_mm.shape[1] != 3:
            raise self._wrong_answer(f"shape {centres_mm.shape}")
        if not np.isfinite(centres_mm).all():
            raise self._wrong_answer("numbers that are not finite")
        geometry = volume.geometry
        from_middle = np.abs(geometry.to_index(centres_mm) * geometry.spacing_mm - 0.5 * volume.extent_mm)
        outside = (from_middle > 0.5 * volume.extent_mm + BESIDE_MM).any(axis=1)
        if outside.any():
            shown = ", ".join(f"{value:.1f}" for value in centres_mm[outside][0])
            raise self._wrong_answer(f"({shown}), which is outside the volume: voxel indices?")
        return centres_mm


class PluginRegistration(CheckedPlugin):
    """User registration, called like `PairedRegistration`; raises STU-013 and STU-014."""

    result = "a rigid transform"
    form = "a SciPy RigidTransform physical <- image, or its matrix (4, 4): rotation, mm, 0 0 0 1"

    def __call__(self, image_mm: Array, physical_mm: Array, *, covariance_mm2: Array) -> RigidTransform:
        """Return the transform physical <- image."""
        answer = call_plugin(self.name, self.function, image_mm, physical_mm, covariance_mm2=covariance_mm2)
        if isinstance(answer, RigidTransform):
            answer = answer.as_matrix()
        matrix = self._as_numbers(answer)
        if matrix.shape != (4, 4):
            raise self._wrong_answer(f"shape {matrix.shape}")
        if not np.isfinite(matrix).all():
            raise self._wrong_answer("numbers that are not finite")
        if (matrix[3] != (0.0, 0.0, 0.0, 1.0)).any():
            raise self._wrong_answer(f"a last row {matrix[3].tolist()}")
        rotation = matrix[:3, :3]
        bent = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
        if bent > ROTATION_TOLERANCE or np.linalg.det(rotation) < 0.0:
            raise self._wrong_answer(
                "a mirror image" if bent <= ROTATION_TOLERANCE else f"axes off by {bent:.1g}"
            )
        return RigidTransform.from_matrix(matrix)


def call_plugin(
    name: str,
    function: Callable[..., Any],
    *arguments: object,
    passed: tuple[type[Exception], ...] = (),
    **named: object,
) -> Any:
    """Call a user method with these arguments; raises STU-013 for any error except those `passed`.

    The global generators are seeded before each call, so that a unit's result does not depend on its worker.
    Prints of the method go to standard error: standard output is for results.
    """
    random.seed(GLOBAL_SEED)
    np.random.seed(GLOBAL_SEED)  # for methods that use it
    try:
        with contextlib.redirect_stdout(sys.stderr):
            return function(
                *map(_read_only, arguments), **{key: _read_only(one) for key, one in named.items()}
            )
    except passed:
        raise
    except (Exception, SystemExit) as error:
        raise MethodFailed(
            f"{name} raised {type(error).__name__}: {error}", got=_locate_error(function, error)
        ) from error


def _read_only(value: object) -> object:
    if not isinstance(value, np.ndarray):
        return value
    copy = value.copy()
    copy.setflags(write=False)
    return copy


def _locate_error(function: Callable[..., Any], error: BaseException) -> str:
    """Return the last traceback line in the method's own file, or else the very last line."""
    frames = traceback.extract_tb(error.__traceback__)
    own_file = getattr(sys.modules.get(function.__module__), "__file__", None)
    last = next((one for one in reversed(frames) if one.filename == own_file), frames[-1])
    return f"{last.filename}, line {last.lineno}"
