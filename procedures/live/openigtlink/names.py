"""OpenIGTLink's names of our frames: `ToolToRas` is the pose of the tool in patient coordinates.

Peers take every matrix and point for RAS. Ours are LPS, so patient coordinates turn about the vertical axis.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from procedures.live.errors import NAME_TOO_LONG
from ronna_hw import patient_frame
from ronna_hw.frames import Frame
from ronna_hw.vectors import Vector3
from ronna_hw.wire.openigtlink import LONGEST_NAME_BYTES
from ronna_hw.wire.openigtlink_contents import Matrix

RAS_FROM_LPS: Final[Matrix] = np.diag([-1.0, -1.0, 1.0, 1.0])
RAS: Final = "Ras"
SPHERES, TARGETS, ENTRIES, PLAN = "Spheres", "Targets", "Entries", "Plan"
RUN_STATE: Final = "RunState"
SERVER: Final = "ronna-hw"  # whose answers are about no device
CT_IMAGE: Final = "CT"
CAMERA_IMAGES: Final = {"left": "CameraLeft", "right": "CameraRight"}
SHORT_WORDS: Final = {  # of frames whose own words are too long, or another
    Frame.CT.value: RAS,
    patient_frame.NAME: "Patient",
    "assistant_flange": "Flange2",
}
POSES: Final = (  # child and parent, of those that a case states; any other is checked when it comes
    (Frame.FLANGE, Frame.ROBOT),
    (Frame.TOOL, Frame.ROBOT),
    (Frame.TRACKER, Frame.ROBOT),
    (Frame.ASSISTANT, Frame.ROBOT),
    (Frame.ROBOT, Frame.CT),
    (Frame.TOOL, Frame.CT),
    (Frame.TOOL, Frame.FLANGE),
    ("assistant_flange", Frame.ASSISTANT),
    (patient_frame.NAME, Frame.TRACKER),
    ("robot_frame", Frame.TRACKER),
)


def frame_word(frame: str) -> str:
    """Return the word for a frame: `CameraLeft`, and `Ras` for patient coordinates."""
    return SHORT_WORDS.get(frame) or "".join(part.capitalize() for part in frame.split("_"))


FRAME_WORDS: Final = frozenset(map(frame_word, Frame))


def transform_name(child: str, parent: str) -> str:
    """Return the name of parent <- child. Raises LIV-010 if it is over 20 bytes."""
    return device_name(f"{frame_word(child)}To{frame_word(parent)}")


def device_name(name: str) -> str:
    """Return a name that fits into a header. Raises LIV-010 for another, which a peer would see cut."""
    if len(name) > LONGEST_NAME_BYTES or not name.isascii():
        raise NAME_TOO_LONG(
            f"{name!r} is no name for OpenIGTLink", limit=f"{LONGEST_NAME_BYTES} bytes of ASCII"
        )
    return name


def check_names() -> None:
    """Raise LIV-010 if the name of a pose or of a list does not fit."""
    for child, parent in POSES:
        transform_name(child, parent)
    for name in (SPHERES, TARGETS, ENTRIES, PLAN, RUN_STATE, SERVER, CT_IMAGE, *CAMERA_IMAGES.values()):
        device_name(name)


def as_ras(position_mm: Vector3) -> Vector3:
    """Return a position in LPS as RAS."""
    x, y, z = position_mm
    return (-x, -y, z)
