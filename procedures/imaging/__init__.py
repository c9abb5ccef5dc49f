"""DICOM CT volumes and localization of marker spheres. Pure numerics.

Names load on first use: the process that decodes compressed slices needs none of the numerics.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ronna_hw.lazy_names import resolve_lazily

if TYPE_CHECKING:
    from procedures.imaging.dicom.slice_headers import PatientIdentity, read_identity
    from procedures.imaging.localization import localize
    from procedures.imaging.localizers import ThesisFit
    from procedures.imaging.markers import Candidate, Localization, Marker, likeliest_first
    from procedures.imaging.picks import localize_picks, read_picks
    from procedures.imaging.series import read_other_series, read_series
    from procedures.imaging.thesis_localizer import localize_as_thesis
    from procedures.imaging.volume import Volume, VoxelGeometry

__all__ = [
    "Candidate",
    "Localization",
    "Marker",
    "PatientIdentity",
    "ThesisFit",
    "Volume",
    "VoxelGeometry",
    "likeliest_first",
    "localize",
    "localize_as_thesis",
    "localize_picks",
    "read_identity",
    "read_other_series",
    "read_picks",
    "read_series",
]

_MODULES = ("markers", "volume", "dicom.slice_headers", "series", "picks", "localization", "thesis_localizer")

__getattr__ = resolve_lazily(__name__, __all__, _MODULES)


def __dir__() -> list[str]:
    return list(__all__)
