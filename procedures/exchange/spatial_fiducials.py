"""Points of a CT as a DICOM Spatial Fiducials object: sphere centres and others, LPS in mm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pydicom.dataset import Dataset
from pydicom.uid import SpatialFiducialsStorage

from procedures.exchange.dicom_object import Origin, decimals, new_object, uid


@dataclass(frozen=True)
class Fiducial:
    """A point: name, position (LPS, mm), radius of its uncertainty (3-D rms, mm), and kind.

    An uncertainty of 0 means not stated.
    """

    name: str
    centre_mm: tuple[float, float, float]
    uncertainty_mm: float
    description: str = "marker sphere"


def fiducial_uid(origin: Origin, fiducial: Fiducial) -> str:
    """The UID of a sphere, both in the fiducials object and in a registration that used it."""
    return str(uid(origin, "fiducial", fiducial.name))


def spatial_fiducials(
    fiducials: Sequence[Fiducial],
    origin: Origin,
    *,
    label: str = "MARKERS",
    description: str = "centres of marker spheres",
) -> Dataset:
    """The object for the points of one CT series."""
    made = new_object(origin, SpatialFiducialsStorage, "FID", label, description)
    group = Dataset()
    group.FrameOfReferenceUID = origin.frame_of_reference_uid
    group.FiducialSequence = [_item(fiducial, origin) for fiducial in fiducials]
    made.FiducialSetSequence = [group]
    return made


def _item(fiducial: Fiducial, origin: Origin) -> Dataset:
    item = Dataset()
    item.FiducialIdentifier = fiducial.name
    item.FiducialDescription = fiducial.description
    item.FiducialUID = fiducial_uid(origin, fiducial)
    item.ShapeType = "POINT"
    item.NumberOfContourPoints = 1
    item.ContourData = decimals(fiducial.centre_mm)
    if fiducial.uncertainty_mm > 0.0:
        item.ContourUncertaintyRadius = fiducial.uncertainty_mm
    return item
