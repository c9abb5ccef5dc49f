"""The options of the stereo pair in the theatre file.

[stereo.options]
left_serial = "21904411"
right_serial = "21904412"
exposure_us = 2000.0
"""

from __future__ import annotations

import json
from typing import Annotated, Literal, Self

from pydantic import Field, ValidationError, model_validator

from drivers.basler_stereo.errors import BadOptions
from ronna_hw.calibration import Strict
from ronna_hw.config import DeviceConfig, describe_mistakes
from ronna_hw.wire import gige_vision as gev

LARGEST_PACKET_BYTES = 16_000  # cameras stop near 9000; a loopback link carries more
SMALLEST_PACKET_BYTES = 576  # every IPv4 path carries it


class BaslerOptions(Strict):
    """Everything that may be said about the pair; without serial numbers any two cameras are taken."""

    left_serial: Annotated[str, Field(min_length=1)] | None = None
    right_serial: Annotated[str, Field(min_length=1)] | None = None
    expected_model: str | None = gev.ACA2000_50GM_NIR  # "" in the file stands for any
    exposure_us: Annotated[float, Field(gt=0, le=gev.EXPOSURE_MAXIMUM_US)] = 2000.0
    gain_raw: Annotated[int, Field(ge=0, le=gev.GAIN_RAW_MAXIMUM)] = gev.GAIN_RAW_MINIMUM
    pixel_format: Literal["Mono8", "Mono12", "Mono12Packed"] = "Mono8"
    packet_bytes: Annotated[int, Field(ge=SMALLEST_PACKET_BYTES, le=LARGEST_PACKET_BYTES)] | None = None
    inter_packet_delay_ticks: Annotated[int, Field(ge=0)] = 0
    heartbeat_ms: Annotated[int, Field(ge=gev.HEARTBEAT_MINIMUM_MS, le=60_000)] = 3000
    resend: bool = True
    trigger: Literal["software", "action", "line1"] = "software"
    action_device_key: Annotated[int, Field(ge=0, le=0xFFFF_FFFF)] = 0x524F_4E4E  # "RONN"
    action_group_key: Annotated[int, Field(ge=0, le=0xFFFF_FFFF)] = 1
    pair_skew_ms: Annotated[float, Field(gt=0, le=1000)] = 50.0  # between the exposures of one pair
    receive_buffer_bytes: Annotated[int, Field(ge=65_536)] = 4 * 1024 * 1024
    load_default_user_set: bool = True  # start from the camera's factory settings

    @model_validator(mode="after")
    def _checks(self) -> Self:
        if self.left_serial is not None and self.left_serial == self.right_serial:
            raise ValueError("left_serial and right_serial are the same camera")
        return self

    @property
    def pixel_format_code(self) -> gev.PixelFormat:
        """The code of the pixel format on the wire."""
        return {
            "Mono8": gev.PixelFormat.MONO8,
            "Mono12": gev.PixelFormat.MONO12,
            "Mono12Packed": gev.PixelFormat.MONO12_PACKED,
        }[self.pixel_format]


def read_options(config: DeviceConfig) -> BaslerOptions:
    """Check the options of the theatre file; raises GEV-016 with every mistake in them."""
    try:
        # by way of JSON: strict types, but a whole number may stand for a float
        return BaslerOptions.model_validate_json(json.dumps(config.options))
    except ValidationError as error:
        mistakes = describe_mistakes(error)
        raise BadOptions(f"stereo options have {len(mistakes)} mistake(s): " + "; ".join(mistakes)) from error
    except TypeError as error:
        raise BadOptions(f"stereo options: {error}") from error
