"""Records of a running case that logs and links receive: poses, joints, points, states, pictures.

They hold what steps, guards and the arm's stream have read anyhow. The feed of a run passes them on as lines
of JSON, in the order in which they were made. Lengths are mm, angles rad, rotations unit quaternions
(w x y z). Frames are spelled as in `Frame`; those of the CT are LPS.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from ronna_hw.devices.readings import Validity
from ronna_hw.vectors import Quaternion, Vector3

LARGEST_LINE_BYTES = 8_000_000  # a picture of a full sensor as JPEG, in base64


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    theatre_time_s: float = Field(description="Of the measurement, or of the change.")

    @property
    def about(self) -> str:
        """Subject of the record; a newer one of its kind on the same subject replaces it."""
        return ""


class FramePose(_Record):
    """Pose of a child frame in its parent: parent <- child. Without usable numbers both are None."""

    kind: Literal["pose"] = "pose"
    parent: str
    child: str
    rotation: Quaternion | None
    translation_mm: Vector3 | None
    validity: Validity = Validity.OK
    is_fixed: bool = False  # until the next record of it: a registration, a base

    @property
    def about(self) -> str:
        return f"{self.child} in {self.parent}"


class ArmJoints(_Record):
    """Joints of an arm, as measured and as commanded."""

    kind: Literal["joints"] = "joints"
    arm: str
    measured_rad: tuple[float, ...]
    commanded_rad: tuple[float, ...] | None = None

    @property
    def about(self) -> str:
        return self.arm


class Fiducial(BaseModel):
    """Sphere in the CT, its residual in the registration in use, and whether that uses it."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: str
    position_mm: Vector3
    diameter_mm: float
    residual_mm: float | None = None
    is_used: bool | None = None  # None: nothing is registered yet


class Fiducials(_Record):
    """Spheres in the CT, in LPS."""

    kind: Literal["fiducials"] = "fiducials"
    spheres: tuple[Fiducial, ...]


class PlannedLine(BaseModel):
    """Trajectory of the plan, in LPS."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: str
    entry_mm: Vector3
    target_mm: Vector3


class PlannedLines(_Record):
    """All trajectories of the plan, in its order."""

    kind: Literal["plan"] = "plan"
    lines: tuple[PlannedLine, ...]


class DeviceStatus(_Record):
    """State of a device, and the code, words and advice of a fault."""

    kind: Literal["device"] = "device"
    device: str
    state: str
    code: str = ""
    text: str = ""
    advice: str = ""

    @property
    def about(self) -> str:
        return self.device


class RunState(_Record):
    """State of the case and the step at work."""

    kind: Literal["run"] = "run"
    run: str
    state: str
    step: str = ""
    reason: str = ""


class CameraPicture(_Record):
    """Picture of one camera as JPEG in base64, with its size in pixels."""

    kind: Literal["picture"] = "picture"
    side: Literal["left", "right"]
    width: int
    height: int
    jpeg: str = Field(repr=False)

    @property
    def about(self) -> str:
        return self.side


class Began(_Record):
    """First record of a feed: the host's time at theatre time 0 (UTC), from which stamps are made."""

    kind: Literal["began"] = "began"
    run: str
    epoch_ns: int
    VERSION: ClassVar[int] = 1
    version: int = VERSION


LiveRecord = Annotated[
    Began | FramePose | ArmJoints | Fiducials | PlannedLines | DeviceStatus | RunState | CameraPicture,
    Field(discriminator="kind"),
]
_READER: TypeAdapter[LiveRecord] = TypeAdapter(LiveRecord)


def as_line(record: LiveRecord) -> bytes:
    """Encode a record as one line of JSON."""
    return record.model_dump_json().encode() + b"\n"


def read_record(line: bytes) -> LiveRecord:
    """Decode a line. Raises ValueError for one that is no record."""
    return _READER.validate_json(line)
