"""Options of a tracker behind an OpenIGTLink server, in the theatre file.

[tracker]
driver = "openigtlink_tracker"
endpoint = "igtl://192.168.1.20:18944"

[[tracker.options.tools]]
name = "robot_frame"
markers_mm = [[0.0, 0.0, 0.0], [28.0, 41.0, 0.0], [88.0, 0.0, 0.0]]
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from drivers.openigtlink_tracker.errors import BAD_OPTIONS
from drivers.theatre_options import parse_options
from ronna_hw.calibration import Numbers3, Strict
from ronna_hw.config import DeviceConfig
from ronna_hw.wire.openigtlink import LONGEST_NAME_BYTES

LEAST_MARKERS = 3
FRAME_LETTERS = 3  # of the tracker's frame that a name must show even where it is cut


class ToolOption(Strict):
    """Tool whose pose the server sends."""

    name: Annotated[str, Field(min_length=1, description="Name of the tool in readings and calibrations.")]
    markers_mm: Annotated[
        tuple[Numbers3, ...],
        Field(
            min_length=LEAST_MARKERS,
            description="Markers in the tool's own frame, that of the definition which the tracker uses.",
        ),
    ]
    sent_as: Annotated[
        str | None,
        Field(
            min_length=1,
            description="Name of the tool's transform at the server; default: the tool's name in capitals, "
            "To, and the tracker's frame, such as `RobotFrameToTracker` of `robot_frame`.",
        ),
    ] = None


class OpenIGTLinkOptions(Strict):
    """Options of a tracker behind an OpenIGTLink server."""

    tools: Annotated[
        tuple[ToolOption, ...], Field(description="Tools to read; whatever else the server sends is ignored.")
    ] = ()
    frame: Annotated[
        str, Field(min_length=1, description="The server's name for the coordinates of the tracker.")
    ] = "Tracker"
    header_version: Annotated[
        Literal[1, 2],
        Field(description="Version of the first query's header: 2 also asks for each pose's validity."),
    ] = 2
    hidden_after_s: Annotated[
        float, Field(gt=0, description="A tool that is not sent for so long is missing.")
    ] = 0.1
    frozen_after_s: Annotated[
        float,
        Field(
            gt=0,
            description="A tool whose pose does not change in a single bit for so long is missing: no "
            "measurement repeats itself.",
        ),
    ] = 0.5
    together_s: Annotated[
        float, Field(gt=0, description="Poses whose time stamps differ by no more are one measurement.")
    ] = 0.005
    silence_limit_s: Annotated[
        float, Field(gt=0, description="A server that sends nothing at all for so long is lost.")
    ] = 1.0

    @model_validator(mode="after")
    def _require_consistent(self) -> Self:
        names = [tool.name for tool in self.tools]
        if duplicates := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"duplicate tool name {', '.join(duplicates)}")
        ending = f"To{self.frame}"
        for sent in self.sent_names.values():
            if not sent.endswith(ending) or sent == ending:
                raise ValueError(f"sent_as {sent!r} does not end in {ending}, so it is no pose in that frame")
            if len(sent) - len(self.frame) + FRAME_LETTERS > LONGEST_NAME_BYTES:
                raise ValueError(
                    f"servers cut {sent} after {LONGEST_NAME_BYTES} characters, and the frame could not be "
                    "told from another: shorten it, here with sent_as and in the server's configuration"
                )
        sent_names = list(self.sent_names.values())
        if shared := sorted({name for name in sent_names if sent_names.count(name) > 1}):
            raise ValueError(f"several tools are sent as {', '.join(shared)}")
        return self

    @property
    def sent_names(self) -> dict[str, str]:
        """Names of the transforms at the server, in full, by tool."""
        return {tool.name: tool.sent_as or f"{_capitalise(tool.name)}To{self.frame}" for tool in self.tools}


def _capitalise(name: str) -> str:
    return "".join(word[:1].upper() + word[1:] for word in name.replace("-", "_").split("_"))


def read_options(config: DeviceConfig) -> OpenIGTLinkOptions:
    """Parse the tracker options from the theatre file; raises IGT-003 listing every mistake."""
    return parse_options(OpenIGTLinkOptions, config.options, "tracker options", BAD_OPTIONS)
