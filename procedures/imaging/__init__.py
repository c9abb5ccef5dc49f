"""DICOM CT volumes and localization of marker spheres. Pure numerics.

Names load on first use: the process that decodes compressed slices needs none of the numerics.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from procedures.imaging.dicom.slice_headers import PatientIdentity, read_identity
    from procedures.imaging.localization import localize
    from procedures.imaging.localizers import ThesisFit
    from procedures.imaging.markers import Candidate, Localization, Marker, likeliest_first
    from procedures.imaging.picks import localize_picks, read_picks
    from procedures.imaging.series import read_series
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
    "read_picks",
    "read_series",
]

_MODULES = ("markers", "volume", "dicom.slice_headers", "series", "picks", "localization", "thesis_localizer")


def __getattr__(name: str) -> Any:
    for module in _MODULES if name in __all__ else ():
        home = import_module(f"{__name__}.{module}")
        if hasattr(home, name):
            globals()[name] = getattr(home, name)
            return globals()[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)
