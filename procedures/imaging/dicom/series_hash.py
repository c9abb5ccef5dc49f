"""Hash of a series by the names and contents of its files, which tells a replaced series at the same path."""

from __future__ import annotations

import hashlib
from pathlib import Path

from procedures.imaging.dicom.slice_headers import list_dicom_files
from ronna_hw.evidence.manifest import sha256_of


def hash_series(series: Path) -> str:
    """Return the SHA-256 of the names and contents of the DICOM files in a folder. Raises CT-001, CT-005."""
    listed = "".join(f"{path.name} {sha256_of(path)}\n" for path in list_dicom_files(series))
    return hashlib.sha256(listed.encode()).hexdigest()
