"""Stereo pair options in the theatre file.

[stereo.options]
left_serial = "21904411"
right_serial = "21904412"
exposure_us = 2000.0
"""

from __future__ import annotations

from typing import Annotated, Literal, Self, TypeVar

from pydantic import Field, model_validator

from drivers.basler_stereo.errors import BAD_OPTIONS
from drivers.theatre_options import parse_options
from ronna_hw.calibration import Strict
from ronna_hw.config import DeviceConfig
from ronna_hw.wire import gige_vision as gev

LARGEST_PACKET_BYTES = 16_000  # cameras stop near 9000; a loopback link carries more
SMALLEST_PACKET_BYTES = 576  # every IPv4 path carries it


class ProjectorOptions(Strict):
    """Wiring of the line projector: an output line of one camera switches it."""

    camera: Literal["left", "right"] = Field(default="left", description="Camera that switches it.")
    line: Annotated[str, Field(min_length=1)] = Field(
        default="Out1", description="Output line, by its name in `LineSelector`."
    )
    source: Literal["UserOutput", "ExposureActive"] = Field(
        default="UserOutput",
        description="Source of the line while the projector is on. UserOutput: lit until it is switched off; "
        "ExposureActive: lit only while that camera exposes, for pairs that one pulse triggers.",
    )
    inverted: bool = Field(default=False, description="Whether the projector is lit while the line is low.")


class BaslerOptions(Strict):
    """Camera pair options; without serial numbers, any two cameras are accepted."""

    left_serial: Annotated[str, Field(min_length=1)] | None = Field(
        default=None, description="Serial number of the left camera; none accepts any."
    )
    right_serial: Annotated[str, Field(min_length=1)] | None = Field(
        default=None, description="Serial number of the right camera; none accepts any."
    )
    expected_model: str | None = Field(
        default=gev.ACA2000_50GM_NIR, description="Model of both cameras; empty for any."
    )
    exposure_us: Annotated[float, Field(gt=0, le=gev.EXPOSURE_MAXIMUM_US)] = Field(
        default=2000.0, description="Exposure of both cameras, in microseconds."
    )
    gain_raw: Annotated[int, Field(ge=0, le=gev.GAIN_RAW_MAXIMUM)] | None = Field(
        default=None,
        description="Gain of both cameras, in the camera's own unit, 20 log10(raw/32) dB; none: the "
        "smallest.",
    )
    pixel_format: Literal["Mono8", "Mono12", "Mono12Packed"] = Field(
        default="Mono8", description="Pixel format of the stream."
    )
    packet_bytes: Annotated[int, Field(ge=SMALLEST_PACKET_BYTES, le=LARGEST_PACKET_BYTES)] | None = Field(
        default=None,
        description="Size of stream packets with IP and UDP headers; none: the largest that arrives.",
    )
    inter_packet_delay_ticks: Annotated[int, Field(ge=0)] = Field(
        default=0, description="Pause between stream packets, in ticks of the camera."
    )
    heartbeat_ms: Annotated[int, Field(ge=gev.HEARTBEAT_MINIMUM_MS, le=60_000)] = Field(
        default=3000, description="Silence after which a camera releases control."
    )
    resend: bool = Field(default=True, description="Request lost packets again.")
    trigger: Literal["software", "action", "line1"] = Field(
        default="software",
        description="software: a command to each camera; action: an action command to each; line1: a "
        "pulse on both lines, for which grab_pair waits.",
    )
    action_device_key: Annotated[int, Field(ge=0, le=0xFFFF_FFFF)] = Field(
        default=0x524F_4E4E, description="Device key of the action commands."
    )
    action_group_key: Annotated[int, Field(ge=0, le=0xFFFF_FFFF)] = Field(
        default=1, description="Group key of the action commands."
    )
    pair_skew_ms: Annotated[float, Field(gt=0, le=1000)] = Field(
        default=50.0,
        description="Largest offset between the exposure starts of a pair; beyond it the pair is UNPAIRED.",
    )
    receive_buffer_bytes: Annotated[int, Field(ge=65_536)] = Field(
        default=16 * 1024 * 1024,
        description="Requested receive buffer of a stream socket; the kernel may cap it.",
    )
    projector: ProjectorOptions | None = Field(
        default=None, description="Line projector on the head; none: the head has none."
    )
    load_default_user_set: bool = Field(default=True, description="Start from the camera's factory settings.")

    @model_validator(mode="after")
    def _require_different_serials(self) -> Self:
        if self.left_serial is not None and self.left_serial == self.right_serial:
            raise ValueError("left_serial and right_serial are equal")
        return self

    def projector_at(self, side: str) -> ProjectorOptions | None:
        """Return the projector that this camera switches, if any."""
        return self.projector if self.projector and self.projector.camera == side else None

    @property
    def pixel_format_code(self) -> gev.PixelFormat:
        """GigE Vision code of the pixel format."""
        return {
            "Mono8": gev.PixelFormat.MONO8,
            "Mono12": gev.PixelFormat.MONO12,
            "Mono12Packed": gev.PixelFormat.MONO12_PACKED,
        }[self.pixel_format]


Options = TypeVar("Options", bound=BaslerOptions)


def read_options(config: DeviceConfig, model: type[Options]) -> Options:
    """Parse the options from the theatre file; raises GEV-016 listing all mistakes."""
    return parse_options(model, config.options, "stereo options", BAD_OPTIONS)
