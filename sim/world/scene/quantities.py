"""Ranges of the values in a scene."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from ronna_hw.wire.gige_vision import TEXT_BYTES, Bootstrap

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
# A camera's register is 0-terminated; a longer number would be reported cut off.
Serial = Annotated[
    str, Field(min_length=1, max_length=TEXT_BYTES[Bootstrap.SERIAL_NUMBER] - 1, pattern=r"^[!-~]+$")
]
