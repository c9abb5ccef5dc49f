"""Theatre file of devices and calibrations, in strict TOML; all mistakes are reported at once."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Self

from pydantic import AfterValidator, Field, PrivateAttr, ValidationError, field_validator, model_validator

from ronna_hw.arm.catalogue import ARMS
from ronna_hw.bounded_input import read_toml
from ronna_hw.calibration import (
    ArmCalibration,
    Dated,
    DatedRecord,
    HolderCalibration,
    Numbers3,
    PoseRecord,
    StereoHeadCalibration,
    Strict,
    ToolTipCalibration,
    TrackerFrameCalibration,
)
from ronna_hw.collision_config import CollisionConfig
from ronna_hw.endpoints import Endpoint, parse_endpoint
from ronna_hw.errors import ConfigurationError
from ronna_hw.mistakes import count_mistakes, find_other_kind, suggest_keys
from ronna_hw.plausible import (
    LONGEST_LIFE,
    ArmError,
    Length,
    MountedError,
    SeatingError,
    SensorPixels,
    farther_than,
)
from ronna_hw.roles import ASSISTANT, MASTER
from ronna_hw.text import format_count
from ronna_hw.theatre_kind import is_simulated
from ronna_hw.tool_record import GuideBore, TipInHead, ToolRecord


def require_expiry(theatre: TheatreFile) -> None:
    """Raise ValueError unless records of a real theatre expire within a year.

    In a simulated theatre nothing is knocked or worn.
    """
    calibrations = {} if theatre.calibration is None else theatre.calibration.records
    records: dict[str, Dated] = {f"calibration.{name}": one for name, one in calibrations.items()}
    records |= {f"tools.{name}": one for name, one in theatre.tools.items()}
    endless = [f"[{table}]" for table, one in records.items() if one.expires - one.created > LONGEST_LIFE]
    if endless and not is_simulated(theatre):
        raise ValueError(
            f"{', '.join(endless)}: expected to expire at most {LONGEST_LIFE.days} days after `created`"
        )


def require_own_frames(theatre: TheatreFile) -> None:
    """Raise ValueError if the patient's frame is also one on an arm, or the holder's one on the master."""
    on_arms, frame = _frames_on_arms(theatre), theatre.procedure.patient_frame
    if shared := [key for key, tool in on_arms.items() if tool == frame]:
        raise ValueError(
            f"[procedure] patient_frame: {frame} is also {' and '.join(shared)}, a frame on the arm: "
            "name the frame on the head clamp, a tool of its own"
        )
    frame = on_arms.pop(HOLDER_FRAME, None)
    if shared := [key for key, tool in on_arms.items() if tool == frame]:
        raise ValueError(
            f"[calibration.assistant_holder] frame: {frame} is also {' and '.join(shared)}, a frame on the "
            "master: name the frame on the holder, a tool of its own"
        )


def _frames_on_arms(theatre: TheatreFile) -> dict[str, str]:
    """Return the tracker's tools on the arms, by the key that names them."""
    if theatre.calibration is None:
        return {}
    on_guides = {
        f"tools.{name}.frame.tool": tool.frame.tool
        for name, tool in theatre.tools.items()
        if tool.frame is not None
    }
    return theatre.calibration.frames | on_guides


def require_separate_arms(theatre: TheatreFile) -> None:
    """Raise ValueError if two arms share an address: then both roles would be played by one arm."""
    owners: dict[tuple[str, int], list[tuple[str, str]]] = {}  # by scheme and port
    for name, robot in theatre.robot.items():
        for text in (robot.endpoint, *robot.endpoints.values()):
            if text is None:
                continue
            endpoint = parse_endpoint(text)
            others = owners.setdefault((endpoint.scheme, endpoint.port), [])
            for owner, other in others:
                if owner == name or not endpoint.is_same_as(parse_endpoint(other)):
                    continue
                shared = text if other == text else f"{text}, which is {other}"
                raise ValueError(
                    f"[robot.{name}] and [robot.{owner}] are the same arm: both have {shared}; give each arm "
                    "its own addresses"
                )
            others.append((name, text))


def require_outside_hand(theatre: TheatreFile) -> None:
    """Raise ValueError if a tool or guide axis is inside the arm's hand, a sign of wrong units."""
    if theatre.calibration is None:
        return
    hand_mm, records = theatre.cell.arm.hand_mm or SLIMMEST_HAND_MM, theatre.calibration
    bore = theatre.tools["guide"].bore if "guide" in theatre.tools else None
    for name, near_mm in (
        ("stereo_head", closest_to_flange_mm(records.stereo_head.flange_from_tool)),
        ("tool_tip", closest_to_flange_mm(records.tool_tip.flange_from_tool, bore)),
    ):
        if near_mm < hand_mm:
            raise ValueError(
                f"[calibration.{name}] flange_from_tool.translation_mm: the tool is {near_mm:.0f} mm from "
                f"the centre of the flange, expected more than cell.arm.hand_mm = {hand_mm:g}, the radius of "
                "the arm's hand: give millimetres, not centimetres"
            )


def closest_to_flange_mm(flange_from_tool: PoseRecord, bore: GuideBore | None = None) -> float:
    """Return the distance in mm from the flange centre to a tip, or to a guide's axis up to its upper end."""
    axis, tip_mm = flange_from_tool.z_axis, flange_from_tool.translation_mm
    length_mm = 0.0 if bore is None else bore.reach_mm + bore.length_mm
    up_mm = sum(coordinate * along for coordinate, along in zip(tip_mm, axis, strict=True))
    up_mm = min(max(up_mm, 0.0), length_mm)
    return math.dist(tip_mm, [up_mm * along for along in axis])


SLIMMEST_HAND_MM = min(arm.kinematics.radii.hand_mm for arm in ARMS.values())
HOLDER_FRAME = "calibration.assistant_holder.frame"
NEAREST_PLACE_MM = 10.0  # from an arm's origin: nothing stands inside its base, and its reach is below 10 m
FARTHEST_APPROACH_MM = 500.0  # as the longest guide
# Two spheres of 11.5 mm that touch are that far apart: one seen farther off than half of it may be another.
# Safety against a sphere taken for its neighbour. Source: the diameter of the spheres.
LARGEST_COARSE_FINE_MM = 5.75
# Safety against a force on the instrument that is not watched, or not limited (U).
LEAST_INSERTION_N = 2.0  # below, the noise of a force from motor currents stops an insertion
LEAST_DRILL_N = 10.0  # below, the feed would be slowed by any cortical bone
LARGEST_INSERTION_N = 50.0  # a Universal Robots arm holds 50 N in its reach; no instrument here needs more


class BadTheatreFile(ConfigurationError):
    """The theatre file is missing, is not TOML, or contains errors (all listed)."""

    code = "CFG-001"
    action = "Correct the file; docs/reference/theatre-file.md lists every key."


class ClockConfig(Strict):
    """Source of theatre time."""

    endpoint: str = Field(
        default="host:",
        description="`host:` for the clock of this computer, `shm://` for that of a simulated theatre.",
    )

    @field_validator("endpoint")
    @classmethod
    def _is_clock_address(cls, value: str) -> str:
        parse_endpoint(value).require("host", "shm")
        return value


def _require_address(text: str) -> str:
    parse_endpoint(text)
    return text


Address = Annotated[str, AfterValidator(_require_address)]


class Role(NamedTuple):
    """Endpoint that a driver needs: an example of its address, and what passes there."""

    example: str
    purpose: str

    @property
    def scheme(self) -> str:
        """Scheme that the address must have."""
        return parse_endpoint(self.example).scheme


class DeviceConfig(Strict):
    """Configuration of a device: driver name, endpoint or endpoints, and driver-specific options."""

    driver: str = Field(description="Name of the driver, as registered by its package.")
    endpoint: Address | None = Field(default=None, description="Address of a device with one endpoint.")
    endpoints: dict[str, Address] = Field(
        default_factory=dict,
        description="Role = address, for a device with several endpoints: `left` and `right` of "
        "basler_stereo; `rsi` and `eki_project` of kuka_rsi; `rtde`, `dashboard` and `primary` of "
        "universal_robots.",
    )
    options: dict[str, Any] = Field(
        default_factory=dict, description="Options of the driver; see its reference page."
    )
    _folder: Path | None = PrivateAttr(default=None)

    @property
    def folder(self) -> Path | None:
        """Theatre-file folder against which `options` resolve relative paths, or None without a file."""
        return self._folder

    def with_folder(self, folder: Path) -> Self:
        """Return a copy whose options resolve relative paths against `folder`."""
        here = self.model_copy()
        here._folder = folder
        return here

    @field_validator("endpoint", mode="before")
    @classmethod
    def _is_one_address(cls, value: object) -> object:
        if isinstance(value, dict):
            raise ValueError("expected one address, got a table: did you mean 'endpoints'?")
        return value

    @model_validator(mode="after")
    def _has_endpoint(self) -> Self:
        if (self.endpoint is None) == (not self.endpoints):
            raise ValueError("give either endpoint or endpoints")
        return self

    def address(self, role: str | None = None) -> Endpoint:
        """Return the parsed endpoint for a role such as `rsi`, or the only one; raises CFG-001 if absent."""
        text = self.endpoint if role is None else self.endpoints.get(role)
        if text is None:
            raise BadTheatreFile(f"driver {self.driver} needs an endpoint {role or ''}".rstrip())
        return parse_endpoint(text)

    def require_addresses(self, roles: Mapping[str, Role], device: str) -> dict[str, Endpoint]:
        """Return the parsed endpoints of these roles; raises CFG-001 naming all that are missing, or CFG-002.

        An endpoint of another role is ignored, but when one is missing it may be a misspelt one.
        """
        if missing := [role for role in roles if role not in self.endpoints]:
            unknown = [role for role in self.endpoints if role not in roles]
            raise BadTheatreFile(
                f"[{device}.endpoints]: driver {self.driver} needs "
                f"{format_count(len(missing), 'more endpoint')}"
                + "".join(f"; endpoint {role} is unknown{suggest_keys(role, missing)}" for role in unknown),
                expected=", ".join(f'{role} = "{roles[role].example}"' for role in missing),
                got=", ".join(self.endpoints) or "one without a role",
            )
        return {
            name: parse_endpoint(self.endpoints[name]).require(role.scheme) for name, role in roles.items()
        }


# Records that the arm in each role needs where there are several.
ARM_RECORDS = {MASTER: ("arm",), ASSISTANT: ("assistant_arm", "assistant_holder")}


class Calibrations(Strict):
    """Calibration records used by the procedure."""

    stereo_head: StereoHeadCalibration = Field(description="Cameras and tool centre of the stereo head.")
    tool_tip: ToolTipCalibration = Field(description="Tip of the surgical guide.")
    tracker_frame: TrackerFrameCalibration = Field(
        description="Reference frame on the mount, seen by the tracker."
    )
    arm: ArmCalibration | None = Field(
        default=None, description="Deviations of the arm; without it the arm is taken as nominal."
    )

    assistant_arm: ArmCalibration | None = Field(
        default=None, description="Deviations of the assistant; two arms are used only with those of both."
    )
    assistant_holder: HolderCalibration | None = Field(
        default=None, description="Holder of the assistant, with frame and ball."
    )

    @property
    def tip_in_head(self) -> TipInHead:
        """Pose of the guide's tip in the frame of the stereo head."""
        return TipInHead.of(self.stereo_head.flange_from_tool, self.tool_tip.flange_from_tool)

    @property
    def arms(self) -> dict[str, ArmCalibration]:
        """Calibration records of the arms, by role."""
        found = {MASTER: self.arm, ASSISTANT: self.assistant_arm}
        return {role: record for role, record in found.items() if record is not None}

    @property
    def holders(self) -> dict[str, HolderCalibration]:
        """Calibration records of the holders, by the role of the arm that carries each."""
        found = {ASSISTANT: self.assistant_holder}
        return {role: record for role, record in found.items() if record is not None}

    @property
    def frames(self) -> dict[str, str]:
        """Tracker's tools on the arms, by the key that names each."""
        on_holders = ((HOLDER_FRAME, holder.frame) for holder in self.holders.values())
        return {"calibration.tracker_frame.tool": self.tracker_frame.tool} | dict(on_holders)

    def of_arms(self, roles: Collection[str]) -> Calibrations:
        """Return the records that a case with arms in these roles uses; those of other arms may be old."""
        unused = [name for role, names in ARM_RECORDS.items() if role not in roles for name in names]
        return self.model_copy(update=dict.fromkeys(unused))

    @property
    def records(self) -> dict[str, DatedRecord]:
        """Calibration records in the theatre file, by name."""
        found = {name: getattr(self, name) for name in type(self).model_fields}
        return {name: record for name, record in found.items() if record is not None}


def _require_order(angles: tuple[float, float]) -> tuple[float, float]:
    if angles[0] > angles[1]:
        raise ValueError(f"the least angle comes first, got {angles[0]:g} and {angles[1]:g}")
    return angles


Angle = Annotated[float, Field(ge=-45.0, le=90.0)]
Recline = Annotated[tuple[Angle, Angle], AfterValidator(_require_order)]
HeadTurn = Annotated[float, Field(gt=0.0, le=60.0)]


class WatchPatient(StrEnum):
    """Motions during which the tracker monitors the patient's spheres."""

    INSTRUMENT = "instrument"  # with the guide mounted, including the hold at the target
    ALWAYS = "always"  # also with the stereo head
    NEVER = "never"  # only at rest, before and after motions


class ProcedureSettings(Strict):
    """Settings and assumptions of the procedure in this theatre."""

    arm_error_mm: ArmError = Field(
        default=0.15,
        description="Local error of the arm per axis, one standard deviation, as long as there is no "
        "[calibration.arm]; less than 0.10 counts as 0.10.",
    )
    tool_error_mm: MountedError = Field(
        default=2.0,
        description="Error of the mount on the flange per axis, one standard deviation, as long as there "
        "is no [calibration.arm]; less than 0.40, the error of the arm's last link, counts as 0.40. The "
        "default is for a mount as designed.",
    )
    seating_error_mm: SeatingError = Field(
        default=0.05,
        description="Displacement of a sphere refitted after the CT from its CT position, per axis, one "
        "standard deviation.",
    )
    sphere_diameter_mm: Annotated[float, Field(ge=11.0, le=12.0), Length] = Field(
        default=11.5,
        description="Diameter of the spheres as the stereo head sees their film, such as `2 radius_mm` of "
        "spheres measured right after its calibration; a median that differs by 0.05 % refuses the head.",
    )
    servo_area_px: tuple[SensorPixels, SensorPixels] = Field(
        default=(1024, 1024), description="Columns and rows of each sensor read by the visual servo."
    )
    approach_mm: Annotated[float, Field(gt=0, le=FARTHEST_APPROACH_MM), Length] = Field(
        default=60.0,
        description="How far back along its axis a tool begins its approach and ends its retreat: from where "
        "the guide is held, which the plan states, from a sphere, and from the entry of a measured target.",
    )
    insertion_force_N: Annotated[float, Field(ge=LEAST_INSERTION_N, le=LARGEST_INSERTION_N)] = Field(
        default=15.0,
        description="Force on the instrument at which an assistant that senses force stops its insertion. "
        "The default is unconfirmed: bone under a drill takes 5 to 20 N.",
    )
    assistant_drills: bool = Field(
        default=False,
        description="An assistant that senses force drills the skull through the guide, before it inserts "
        "the instrument; otherwise a hand drills.",
    )
    drill_force_N: Annotated[float, Field(ge=LEAST_DRILL_N, le=LARGEST_INSERTION_N)] = Field(
        default=30.0,
        description="Force on the drill at which its feed stops; from 60 % of it on the feed is slowed. The "
        "default is unconfirmed: a drill of 3.2 mm takes about 15 N in cortical bone.",
    )
    coarse_fine_limit_mm: Annotated[float, Field(gt=0, le=LARGEST_COARSE_FINE_MM), Length] = Field(
        default=3.0, description="Largest difference between stereo head and tracker for the same sphere."
    )
    stand_mm: Annotated[Numbers3, farther_than(NEAREST_PLACE_MM)] | None = Field(
        default=None, description="Position of the calibration stand's ball, within 10 mm, robot frame."
    )
    watch_patient: Annotated[WatchPatient, Field(strict=False)] = Field(
        default=WatchPatient.INSTRUMENT,
        description="Motions in which the tracker watches the spheres on the head; a shift stops the arm.",
    )
    patient_frame: Annotated[str, Field(min_length=1)] | None = Field(
        default=None,
        description="Tracker's name for the reference frame on the head clamp, `patient_frame` for the one "
        "whose definition is shipped; default: none is used.",
    )
    recline_deg: Recline = Field(
        default=(0.0, 60.0),
        description="Least and largest angle by which the table raises the upper body from lying flat.",
    )
    head_turn_deg: HeadTurn = Field(
        default=30.0,
        description="How far the clamp may turn or tilt the head beyond that, with what the arm's base is "
        "off level; a match in which it lies otherwise is refused.",
    )


class TheatreFile(Strict):
    """Contents of a theatre file, with any number of named robots."""

    schema_version: Annotated[Literal[1], Field(alias="schema")] = Field(
        default=1, description="Version of the file format."
    )
    theatre: str = Field(description="Name of the theatre.")
    banner: str = Field(default="", description="Shown in terminal and report to tell theatres apart.")
    identity: str = Field(
        default="",
        pattern="^([0-9a-f]{32})?$",
        description="Identity of a simulated theatre, by `ronna-sim theatre`; also in copies of the file.",
    )
    tells_truth: bool = Field(
        default=False,
        description="Whether a simulated theatre tells its truth, by `--tell-truth`: no run is made in it.",
    )
    clock: ClockConfig = Field(default=ClockConfig(), description="Source of theatre time.")
    tracker: DeviceConfig | None = Field(default=None, description="The optical tracker.")
    robot: dict[str, DeviceConfig] = Field(
        default_factory=dict,
        description="Name = arm; the procedure uses `master`, with two arms also `assistant`.",
    )
    stereo: DeviceConfig | None = Field(default=None, description="The stereo head.")
    device: dict[str, DeviceConfig] = Field(
        default_factory=dict, description="Name = device of any other kind, such as a force sensor."
    )
    calibration: Calibrations | None = Field(default=None, description="Calibration records.")
    flange: str = Field(
        default="", description="Name of the arm's flange, or of the changer on it, as in the tool records."
    )
    tools: dict[str, ToolRecord] = Field(
        default_factory=dict,
        description="Name = tool that can be mounted on the arm; the procedure uses `guide`.",
    )
    cell: CollisionConfig = Field(
        default=CollisionConfig(), description="Bodies around the arm, for collision checks."
    )
    procedure: ProcedureSettings = Field(
        default=ProcedureSettings(), description="Assumptions and settings of the procedure."
    )

    @model_validator(mode="before")
    @classmethod
    def _has_arms_by_role(cls, content: object) -> object:
        """Name the table to write for an arm that stands outside [robot.NAME]."""
        if not isinstance(content, dict):
            return content
        if roles := [role for role in ARM_RECORDS if role in content]:
            raise ValueError(", ".join(f"[{role}] is an arm: write [robot.{role}]" for role in roles))
        arms = content.get("robot")
        if isinstance(arms, dict) and (keys := [key for key in arms if key in DeviceConfig.model_fields]):
            raise ValueError(
                f"[robot] has {', '.join(keys)}, which belong to one arm: write [robot.{MASTER}], and "
                f"likewise [robot.{MASTER}.endpoints] and [robot.{MASTER}.options]"
            )
        return content

    @field_validator("tools")
    @classmethod
    def _have_unique_numbers(cls, tools: dict[str, ToolRecord]) -> dict[str, ToolRecord]:
        owners: dict[int, str] = {}
        for name, tool in tools.items():
            if (owner := owners.setdefault(tool.number, name)) != name:
                raise ValueError(
                    f"{name} has number {tool.number}, already used by {owner}: expected a unique number, "
                    "as reported by the controller's inputs"
                )
        return tools

    @model_validator(mode="after")
    def _records_are_plausible(self) -> Self:
        require_expiry(self)
        require_outside_hand(self)
        require_own_frames(self)
        require_separate_arms(self)
        return self

    @property
    def cell_with_tools(self) -> CollisionConfig:
        """Collision bodies around the arm, including those from the tool records."""
        own: dict[str, object] = {
            name: tool.bodies
            for name, tool in self.tools.items()
            if tool.bodies and name in ("stereo_head", "guide")
        }
        return self.cell.model_copy(update=own)

    @property
    def addresses(self) -> dict[str, tuple[str, ...]]:
        """Addresses of every device, keyed by device name."""
        return {
            name: (*one.endpoints.values(), *([one.endpoint] if one.endpoint else []))
            for name, one in self.devices.items()
        }

    @property
    def clock_address(self) -> str:
        """Address of the clock."""
        return self.clock.endpoint

    @property
    def devices(self) -> dict[str, DeviceConfig]:
        """All devices by table name: `robot.master`, `tracker`, `stereo`, `device.force`."""
        tables = {
            **{f"robot.{name}": config for name, config in self.robot.items()},
            "tracker": self.tracker,
            "stereo": self.stereo,
            **{f"device.{name}": config for name, config in self.device.items()},
        }
        return {name: config for name, config in tables.items() if config is not None}


def read_theatre_file(path: Path) -> TheatreFile:
    """Read and validate a theatre file; raises CFG-001 listing every mistake."""
    try:
        content = read_toml(path, BadTheatreFile)
    except OSError as error:
        raise BadTheatreFile(
            f"cannot read {path}: {error.strerror}",
            action="Give the path of a theatre file; ronna-procedure new-theatre writes one, "
            "ronna-sim theatre that of a simulated theatre.",
        ) from error
    theatre = parse_theatre(content, path.name)
    folder = path.resolve().parent
    return theatre.model_copy(
        update={
            "tracker": theatre.tracker and theatre.tracker.with_folder(folder),
            "stereo": theatre.stereo and theatre.stereo.with_folder(folder),
            "robot": {name: arm.with_folder(folder) for name, arm in theatre.robot.items()},
            "device": {name: device.with_folder(folder) for name, device in theatre.device.items()},
        }
    )


def parse_theatre(content: dict[str, Any], name: str = "theatre file") -> TheatreFile:
    """Validate theatre-file contents; raises CFG-001 listing every mistake."""
    if not content:
        raise BadTheatreFile(
            f"{name} is empty",
            expected="the keys of a theatre file, such as theatre and [tracker]",
            action="ronna-procedure new-theatre writes one, ronna-sim theatre that of a simulated theatre.",
        )
    if kind := find_other_kind(content, "theatre"):
        raise BadTheatreFile(
            f"{name} is {kind}, not a theatre file", action="Give the path of a theatre file."
        )
    try:
        # Strict models refuse TOML's lists where tuples are declared, so lists are converted to tuples first.
        return TheatreFile.model_validate(_tuples(content))
    except ValidationError as error:
        raise BadTheatreFile(f"{name} has {count_mistakes(error, TheatreFile)}") from error


def _tuples(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _tuples(item) for key, item in value.items()}
    if isinstance(value, list):
        return tuple(_tuples(item) for item in value)
    return value
