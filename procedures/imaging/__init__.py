"""DICOM volumes and the localization of spheres in them. Pure numerics: no engine, no devices."""

from procedures.imaging.dicom.patient_identity import PatientIdentity, read_identity
from procedures.imaging.localization import localize
from procedures.imaging.markers import Candidate, Localization, Marker, likeliest_first
from procedures.imaging.pick_files import read_picks
from procedures.imaging.picks import localize_picks
from procedures.imaging.series import read_series
from procedures.imaging.thesis.localization import ThesisFit, localize_as_thesis
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
