"""Features of the exposure, the gain and the black level."""

from __future__ import annotations

from typing import Any

from ronna_hw.wire.gige_vision import (
    EXPOSURE_MAXIMUM_US,
    EXPOSURE_MINIMUM_US,
    GAIN_RAW_MAXIMUM,
    GAIN_RAW_MINIMUM,
)
from sim.basler.camera.features import Commands, Feature, Kind, always, constant, only, setting
from sim.basler.camera.timing import readout_us

BLACK_LEVEL_RAW_MAXIMUM = 255
CONTROL = "AcquisitionTrigger"


def _set_exposure(commands: Commands, value: float) -> None:
    commands.settings.exposure_us = round(value)


EXPOSURE_LIMITS: dict[str, Any] = {
    "minimum": always(EXPOSURE_MINIMUM_US),
    "maximum": always(EXPOSURE_MAXIMUM_US),
}
ANALOG = "AnalogControls"
INSIDE_C = 45.0  # a camera warmed up on its mount; constant here
EXPOSURE_FEATURES: tuple[Feature, ...] = (
    constant("ExposureMode", CONTROL, "Exposure mode.", 0, **only("Timed")),
    constant("ExposureAuto", CONTROL, "Automatic exposure.", 0, **only("Off")),
    Feature(
        "ExposureTimeAbs",
        Kind.FLOAT,
        CONTROL,
        "Exposure time.",
        read=lambda commands: commands.settings.exposure_us,
        write=_set_exposure,
        unit="us",
        **EXPOSURE_LIMITS,
    ),
    setting("ExposureTimeRaw", CONTROL, "Exposure time in time bases.", "exposure_us", **EXPOSURE_LIMITS),
    constant("ExposureTimeBaseAbs", CONTROL, "Step of the exposure time.", 1.0, kind=Kind.FLOAT, unit="us"),
    Feature(
        "ReadoutTimeAbs",
        Kind.FLOAT,
        CONTROL,
        "Read-out time of the current area.",
        read=lambda commands: readout_us(commands.settings.frame()),
        unit="us",
    ),
    constant("TemperatureAbs", ANALOG, "Inside the camera.", INSIDE_C, kind=Kind.FLOAT, unit="C"),
    constant("GainAuto", ANALOG, "Automatic gain.", 0, **only("Off")),
    constant(
        "GainSelector", ANALOG, "Signal to which the gain applies.", 0, selects=("GainRaw",), **only("All")
    ),
    setting(
        "GainRaw",
        ANALOG,
        "Gain; 20 log10(value / 32) dB.",
        "gain_raw",
        minimum=always(GAIN_RAW_MINIMUM),
        maximum=always(GAIN_RAW_MAXIMUM),
    ),
    constant(
        "BlackLevelSelector",
        ANALOG,
        "Signal to which the black level applies.",
        0,
        selects=("BlackLevelRaw",),
        **only("All"),
    ),
    setting(
        "BlackLevelRaw",
        ANALOG,
        "Value of a dark pixel, on a 10-bit scale.",
        "black_level_raw",
        minimum=always(0),
        maximum=always(BLACK_LEVEL_RAW_MAXIMUM),
    ),
)
