"""A user's registration, with its answer checked: a rotation and a translation, nothing else."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from studies.own.calling import OwnCallable, called
from studies.own.numbers import real_numbers

Array = NDArray[np.float64]

ROTATION_TOLERANCE = 1e-6  # on the products of a rotation's columns: 0.1 µm over a head


class OwnRegistration(OwnCallable):
    """Called like `PairedRegistration`; raises STU-013 and STU-014."""

    result = "a rigid transform"
    form = "a SciPy RigidTransform physical <- image, or its matrix (4, 4): rotation, mm, 0 0 0 1"

    def __call__(self, image_mm: Array, physical_mm: Array, *, covariance_mm2: Array) -> RigidTransform:
        """The transform physical <- image."""
        answer = called(self.name, self.function, image_mm, physical_mm, covariance_mm2=covariance_mm2)
        if isinstance(answer, RigidTransform):
            answer = answer.as_matrix()
        try:
            matrix = real_numbers(answer)
        except ValueError as error:
            raise self._wrong(str(error)) from None
        if matrix.shape != (4, 4):
            raise self._wrong(f"shape {matrix.shape}")
        if not np.isfinite(matrix).all():
            raise self._wrong("numbers that are not finite")
        if (matrix[3] != (0.0, 0.0, 0.0, 1.0)).any():
            raise self._wrong(f"a last row {matrix[3].tolist()}")
        rotation = matrix[:3, :3]
        bent = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
        if bent > ROTATION_TOLERANCE or np.linalg.det(rotation) < 0.0:
            raise self._wrong("a mirror image" if bent <= ROTATION_TOLERANCE else f"axes off by {bent:.1g}")
        return RigidTransform.from_matrix(matrix)
