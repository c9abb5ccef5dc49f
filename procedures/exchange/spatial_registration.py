"""A rigid registration as a DICOM Spatial Registration object: CT to robot, or CT to CT."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import Dataset
from pydicom.uid import SpatialFiducialsStorage, SpatialRegistrationStorage

from procedures.exchange.dicom_object import Origin, code, decimals, instance_uid, new_object, uid
from ronna_hw.frames import Transform

FIDUCIAL_ALIGNMENT = ("125022", "DCM", "Fiducial Alignment")
CONTENT_ALIGNMENT = ("125024", "DCM", "Image Content-based Alignment")


def spatial_registration(
    robot_from_ct: Transform,
    origin: Origin,
    *,
    spheres: Origin | None = None,
    placing: str = "",
    label: str = "CT_TO_ROBOT",
    description: str = "",
    fiducial_uids: Sequence[str] = (),
) -> Dataset:
    """The object for a pose robot <- CT.

    Its own frame of reference is the robot's; the pose maps the CT's into it. `fiducial_uids` name the
    spheres used by the fit, in the fiducials object of the origin `spheres` (by default the same). All
    registrations made from the same spheres with the cart at the same `placing` share one robot frame; once
    the cart has moved, it is a different one.
    """
    spheres = spheres or origin
    made = new_object(origin, SpatialRegistrationStorage, "REG", label, description)
    made.FrameOfReferenceUID = uid(spheres, "robot frame", placing)
    made.PositionReferenceIndicator = ""
    made.RegistrationSequence = [
        _item(made.FrameOfReferenceUID, np.eye(4)),
        _item(origin.frame_of_reference_uid, robot_from_ct.as_matrix()),
    ]
    if fiducial_uids:
        made.RegistrationSequence[1].UsedFiducialsSequence = [_used(one, spheres) for one in fiducial_uids]
    return made


def frames_registration(
    first_from_second: NDArray[np.float64],
    origin: Origin,
    second_frame_uid: str,
    *,
    label: str,
    description: str,
) -> Dataset:
    """The object for the pose (4, 4) mm of a second CT in the frame of reference of the origin's CT."""
    made = new_object(origin, SpatialRegistrationStorage, "REG", label, description)
    made.FrameOfReferenceUID = origin.frame_of_reference_uid
    made.PositionReferenceIndicator = ""
    made.RegistrationSequence = [
        _item(origin.frame_of_reference_uid, np.eye(4), CONTENT_ALIGNMENT),
        _item(second_frame_uid, first_from_second, CONTENT_ALIGNMENT),
    ]
    return made


def _item(
    frame_of_reference_uid: str,
    matrix: NDArray[np.float64],
    alignment: tuple[str, str, str] = FIDUCIAL_ALIGNMENT,
) -> Dataset:
    step = Dataset()
    step.FrameOfReferenceTransformationMatrixType = "RIGID"
    step.FrameOfReferenceTransformationMatrix = decimals(matrix.ravel().tolist())
    transform = Dataset()
    transform.RegistrationTypeCodeSequence = [code(*alignment)]
    transform.MatrixSequence = [step]
    item = Dataset()
    item.FrameOfReferenceUID = frame_of_reference_uid
    item.MatrixRegistrationSequence = [transform]
    return item


def _used(fiducial_uid: str, origin: Origin) -> Dataset:
    item = Dataset()
    item.ReferencedSOPClassUID = SpatialFiducialsStorage
    item.ReferencedSOPInstanceUID = instance_uid(origin, "FID")
    item.FiducialUID = fiducial_uid
    return item
