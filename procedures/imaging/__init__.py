"""DICOM volumes and the localization of spheres in them. Pure numerics: no engine, no devices."""

from procedures.imaging.localization import localize
from procedures.imaging.markers import Candidate, Localization, Marker
from procedures.imaging.series import read_series
from procedures.imaging.volume import Volume, VoxelGeometry

__all__ = ["Candidate", "Localization", "Marker", "Volume", "VoxelGeometry", "localize", "read_series"]
