from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
import pytest
from numpy.typing import NDArray
from painted_ct import write_series


@pytest.fixture(autouse=True)
def misspelt_attributes_raise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pydicom.config, "INVALID_KEYWORD_BEHAVIOR", "RAISE")


@pytest.fixture
def dicom_series(tmp_path: Path) -> Callable[..., Path]:
    """Writes a series under the folder of the test."""

    def write(
        voxels: NDArray[np.int16] | None = None, *args: Any, name: str = "series", **options: Any
    ) -> Path:
        plain = np.arange(5 * 6 * 7, dtype=np.int16).reshape(5, 6, 7) - 1000
        return write_series(tmp_path / name, plain if voxels is None else voxels, *args, **options)

    return write
