"""The postoperative check as DICOM objects: registration of the two CTs, points of every trajectory."""

from __future__ import annotations

import hashlib
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from procedures.exchange.allowed_fields import label_of, only_allowed
from procedures.exchange.dicom_object import Origin, write
from procedures.exchange.spatial_fiducials import Fiducial, spatial_fiducials
from procedures.exchange.spatial_registration import frames_registration
from procedures.postoperative.summary import PostoperativeCheck
from ronna_hw.records import canonical_json

REGISTRATION_FILE = "postoperative-registration.dcm"
POINTS_FILE = "postoperative-points.dcm"


def write_postoperative(check: PostoperativeCheck, frames: tuple[str, str], folder: Path) -> tuple[Path, ...]:
    """Write both objects; `frames` are the frames of reference of the planned CT and the later one.

    The registration is left out when both CTs claim the same frame of reference. Raises EXC-002, EXC-004.
    """
    key = hashlib.sha256(canonical_json(check.model_dump(mode="json"))).hexdigest()
    origin = Origin(check.pre_series_instance_uid, frames[0], datetime.now(UTC), key)
    points = spatial_fiducials(
        _points(check), origin, label="POSTOPERATIVE", description="planned and found entries and targets"
    )
    written = [write(only_allowed(points), folder / POINTS_FILE)]
    if frames[0] != frames[1]:
        pre_from_post = RigidTransform.from_matrix(np.array(check.post_from_pre)).inv().as_matrix()
        registration = frames_registration(
            pre_from_post, origin, frames[1], label="POST_TO_PRE", description="registered on bone"
        )
        written.append(write(only_allowed(registration), folder / REGISTRATION_FILE))
    return tuple(written)


def _points(check: PostoperativeCheck) -> list[Fiducial]:
    found = []
    for number, one in enumerate(check.trajectories, start=1):
        label = label_of(one.id, number)
        places = {
            "planned entry": one.planned_entry_mm,
            "planned target": one.planned_target_mm,
            "entry": one.entry_mm,
            "tip": one.tip_mm,
        }
        found += [
            Fiducial(f"{label} {what}", place, 0.0, "point of a trajectory")
            for what, place in places.items()
            if place is not None
        ]
    return found
