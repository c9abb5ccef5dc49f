"""The theatre file: which devices there are, where they answer, and how they are calibrated.

TOML, strict: unknown keys are errors, and all mistakes are reported at once.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, PrivateAttr, ValidationError, field_validator, model_validator

from ronna_hw.calibration import StereoHeadCalibration, Strict, ToolTipCalibration, TrackerFrameCalibration
from ronna_hw.cell import CellConfig
from ronna_hw.endpoints import Endpoint, parse_endpoint
from ronna_hw.errors import ConfigurationError


class BadTheatreFile(ConfigurationError):
    """The theatre file is missing, not TOML, or has mistakes; all of them are listed."""

    code = "CFG-001"
    action = "Correct the file; the reference lists every key."


class ClockConfig(Strict):
    """Where the theatre's time comes from."""

    endpoint: str = "host:"

    @field_validator("endpoint")
    @classmethod
    def _parses(cls, value: str) -> str:
        parse_endpoint(value).require("host", "shm")
        return value


class DeviceConfig(Strict):
    """One device: its driver by name, its endpoint or endpoints, and the driver's own options."""

    driver: str
    endpoint: str | None = None
    endpoints: dict[str, str] = Field(default_factory=dict)
    options: dict[str, Any] = Field(default_factory=dict)
    _folder: Path | None = PrivateAttr(default=None)

    @property
    def folder(self) -> Path | None:
        """Folder of the theatre file, where relative paths in `options` begin; None without a file."""
        return self._folder

    def read_from(self, folder: Path) -> Self:
        """The same device, as a theatre file in that folder says it."""
        here = self.model_copy()
        here._folder = folder
        return here

    @model_validator(mode="after")
    def _has_endpoint(self) -> Self:
        if (self.endpoint is None) == (not self.endpoints):
            raise ValueError("give either endpoint or endpoints")
        for value in (*self.endpoints.values(), *([self.endpoint] if self.endpoint else [])):
            parse_endpoint(value)
        return self

    def address(self, role: str | None = None) -> Endpoint:
        """The parsed endpoint of a role such as `rsi`, or the only one; raises CFG-001 when absent."""
        text = self.endpoint if role is None else self.endpoints.get(role)
        if text is None:
            raise BadTheatreFile(f"driver {self.driver} needs an endpoint {role or ''}".rstrip())
        return parse_endpoint(text)


class Calibrations(Strict):
    """The calibration records that the procedure uses."""

    stereo_head: StereoHeadCalibration
    tool_tip: ToolTipCalibration
    tracker_frame: TrackerFrameCalibration


class ProcedureSettings(Strict):
    """What the procedure may assume of this theatre, and how it works in it."""

    arm_error_mm: Annotated[float, Field(ge=0)] = 0.15  # local error of the arm per axis, one sigma
    servo_area_px: tuple[int, int] = (1024, 1024)  # part of each sensor that the visual servo reads
    standoff_mm: Annotated[float, Field(gt=0)] = 60.0  # of approach and retreat, outside the entry
    coarse_fine_limit_mm: Annotated[float, Field(gt=0)] = 3.0  # beyond it the sphere is another one


class TheatreFile(Strict):
    """A whole theatre. Robots are named, never assumed to be one."""

    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    theatre: str
    banner: str = ""  # shown on the terminal and in the report, so that two kinds are never confused
    clock: ClockConfig = ClockConfig()
    tracker: DeviceConfig | None = None
    robot: dict[str, DeviceConfig] = Field(default_factory=dict)
    stereo: DeviceConfig | None = None
    calibration: Calibrations | None = None
    cell: CellConfig = CellConfig()
    procedure: ProcedureSettings = ProcedureSettings()


def read_theatre_file(path: Path) -> TheatreFile:
    """Read and check a theatre file; raises CFG-001 with every mistake in it."""
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadTheatreFile(f"cannot read {path.name}: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise BadTheatreFile(f"{path.name} is not TOML: {error}") from error
    theatre = parse_theatre(content, path.name)
    folder = path.resolve().parent
    places: dict[str, Any] = {"robot": {name: arm.read_from(folder) for name, arm in theatre.robot.items()}}
    for name in ("tracker", "stereo"):
        device: DeviceConfig | None = getattr(theatre, name)
        places[name] = None if device is None else device.read_from(folder)
    return theatre.model_copy(update=places)


def parse_theatre(content: dict[str, Any], name: str = "theatre file") -> TheatreFile:
    """Check the content of a theatre file; raises CFG-001 with every mistake in it."""
    try:
        # Strict models refuse TOML's lists where tuples are declared; pydantic's JSON-like mode takes them.
        return TheatreFile.model_validate(_tuples(content))
    except ValidationError as error:
        mistakes = describe_mistakes(error)
        raise BadTheatreFile(f"{name} has {len(mistakes)} mistake(s): " + "; ".join(mistakes)) from error


def describe_mistakes(error: ValidationError) -> list[str]:
    """One short line per mistake: where it is, what was expected, what stands there."""
    lines = []
    for item in error.errors(include_url=False):
        where = ".".join(str(part) for part in item["loc"]) or "file"
        message = item["msg"].removeprefix("Value error, ")
        value = item.get("input")
        shown = f" (found {value!r})" if isinstance(value, str | int | float | bool) else ""
        lines.append(f"{where}: {message}{shown}")
    return lines


def _tuples(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _tuples(item) for key, item in value.items()}
    if isinstance(value, list):
        return tuple(_tuples(item) for item in value)
    return value
