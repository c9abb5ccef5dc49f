"""Image capture features: image format, acquisition, triggers, exposure and gain."""

from __future__ import annotations

from ronna_hw.wire.gige_vision import AREA_STEP_X_PX as STEP_X
from ronna_hw.wire.gige_vision import (
    EXPOSURE_MAXIMUM_US,
    EXPOSURE_MINIMUM_US,
    GAIN_RAW_MAXIMUM,
    GAIN_RAW_MINIMUM,
    SENSOR_HEIGHT_PX,
    SENSOR_WIDTH_PX,
    PixelFormat,
)
from sim.basler.camera.features import (
    Feature,
    FeatureState,
    Kind,
    choice,
    command,
    constant,
    in_category,
    setting,
    single_choice,
    trigger_setting,
)
from sim.basler.settings import (
    AcquisitionMode,
    RampImage,
    Trigger,
    TriggerSource,
    bits_per_pixel,
    free_running_period_us,
    readout_us,
)

PIXEL_SIZES = {"Bpp8": 8, "Bpp12": 12, "Bpp16": 16}
IMAGE_FEATURES = in_category(
    "ImageFormat",
    constant("SensorWidth", "Width of the sensor.", SENSOR_WIDTH_PX, unit="px"),
    constant("SensorHeight", "Height of the sensor.", SENSOR_HEIGHT_PX, unit="px"),
    constant("WidthMax", "Largest width.", SENSOR_WIDTH_PX, unit="px"),
    constant("HeightMax", "Largest height.", SENSOR_HEIGHT_PX, unit="px"),
    setting(
        "Width",
        "Width of the area of interest.",
        "width",
        limits=(STEP_X, lambda camera: SENSOR_WIDTH_PX - camera.settings.offset_x),
        step=STEP_X,
        unit="px",
        locked=True,
    ),
    setting(
        "Height",
        "Height of the area of interest.",
        "height",
        limits=(1, lambda camera: SENSOR_HEIGHT_PX - camera.settings.offset_y),
        unit="px",
        locked=True,
    ),
    setting(
        "OffsetX",
        "Column of the area's left edge; may change during an acquisition.",
        "offset_x",
        limits=(0, lambda camera: SENSOR_WIDTH_PX - camera.settings.width),
        step=STEP_X,
        unit="px",
    ),
    setting(
        "OffsetY",
        "Row of the area's upper edge; may change during an acquisition.",
        "offset_y",
        limits=(0, lambda camera: SENSOR_HEIGHT_PX - camera.settings.height),
        unit="px",
    ),
    choice(
        "PixelFormat",
        "Format of the pixels on the wire.",
        "pixel_format",
        entries={
            "Mono8": PixelFormat.MONO8,
            "Mono12": PixelFormat.MONO12,
            "Mono12Packed": PixelFormat.MONO12_PACKED,
        },
        locked=True,
    ),
    Feature(
        "PixelSize",
        "Bits of a pixel on the wire.",
        Kind.ENUMERATION,
        read=lambda camera: bits_per_pixel(PixelFormat(camera.settings.pixel_format)),
        entries=PIXEL_SIZES,
    ),
    choice(
        "TestImageSelector",
        "A ramp instead of the sensor's image.",
        "test_image",
        entries={"Off": RampImage.OFF, "Testimage1": RampImage.FIXED, "Testimage2": RampImage.MOVING},
    ),
)


FRAME_RATE_RANGE_HZ = (0.1, 1000.0)
LONGEST_TRIGGER_DELAY_US = 1_000_000.0
MOST_FRAMES_PER_ACQUISITION = 255
OFF_ON = {"Off": 0, "On": 1}
FRAME_TRIGGER_WAIT, ACQUISITION_ACTIVE = 0, 1


def _status(camera: FeatureState) -> int:
    if camera.settings.status_selector == FRAME_TRIGGER_WAIT:
        return int(camera.acquisition.awaits_trigger)
    return int(camera.acquisition.running)


CONTROL = "AcquisitionTrigger"
ACQUISITION_FEATURES = in_category(
    CONTROL,
    choice(
        "AcquisitionMode",
        "Acquisition mode.",
        "acquisition_mode",
        entries={"SingleFrame": AcquisitionMode.SINGLE_FRAME, "Continuous": AcquisitionMode.CONTINUOUS},
        locked=True,
    ),
    command(
        "AcquisitionStart", "Start the acquisition of frames.", lambda camera: camera.acquisition.start()
    ),
    command("AcquisitionStop", "Stop the acquisition of frames.", lambda camera: camera.acquisition.stop()),
    command(
        "AcquisitionAbort",
        "Stop the acquisition of frames at once.",
        lambda camera: camera.acquisition.stop(),
    ),
    setting(
        "AcquisitionFrameCount",
        "Frames that one AcquisitionStart trigger permits.",
        "acquisition_frame_count",
        limits=(1, MOST_FRAMES_PER_ACQUISITION),
    ),
    setting(
        "AcquisitionFrameRateEnable",
        "Limit the rate of the free-running camera.",
        "frame_rate_enabled",
        kind=Kind.BOOLEAN,
    ),
    setting(
        "AcquisitionFrameRateAbs",
        "Requested rate of the free-running camera.",
        "frame_rate_hz",
        kind=Kind.FLOAT,
        limits=FRAME_RATE_RANGE_HZ,
        unit="Hz",
    ),
    Feature(
        "ResultingFrameRateAbs",
        "Rate allowed by exposure, read-out, link and requested rate.",
        Kind.FLOAT,
        read=lambda camera: 1e6 / free_running_period_us(camera.settings),
        unit="Hz",
    ),
    choice(
        "AcquisitionStatusSelector",
        "Status shown by AcquisitionStatus.",
        "status_selector",
        entries={"FrameTriggerWait": FRAME_TRIGGER_WAIT, "AcquisitionActive": ACQUISITION_ACTIVE},
        selects=("AcquisitionStatus",),
    ),
    Feature("AcquisitionStatus", "The selected status.", Kind.BOOLEAN, read=_status),
    choice(
        "TriggerSelector",
        "Trigger to which the following features apply.",
        "trigger_selector",
        entries={"AcquisitionStart": Trigger.ACQUISITION_START, "FrameStart": Trigger.FRAME_START},
        selects=("TriggerMode", "TriggerSource", "TriggerActivation", "TriggerDelayAbs", "TriggerSoftware"),
    ),
    trigger_setting(
        "TriggerMode", "Wait for the selected trigger.", "mode", Kind.ENUMERATION, entries=OFF_ON
    ),
    trigger_setting(
        "TriggerSource",
        "Source of the selected trigger.",
        "source",
        Kind.ENUMERATION,
        entries={
            "Software": TriggerSource.SOFTWARE,
            "Line1": TriggerSource.LINE_1,
            "Action1": TriggerSource.ACTION_1,
        },
    ),
    trigger_setting(
        "TriggerActivation",
        "Edge of a line's signal.",
        "activation",
        Kind.ENUMERATION,
        entries={"RisingEdge": 0, "FallingEdge": 1},
    ),
    trigger_setting(
        "TriggerDelayAbs",
        "Time from the trigger to the exposure.",
        "delay_us",
        Kind.FLOAT,
        limits=(0.0, LONGEST_TRIGGER_DELAY_US),
        unit="us",
    ),
    command(
        "TriggerSoftware", "Fire the selected trigger.", lambda camera: camera.acquisition.software_trigger()
    ),
    Feature(
        "OvertriggerCount",
        "Frame triggers missed since AcquisitionStart because the camera was busy.",
        read=lambda camera: camera.acquisition.missed_triggers,
        visibility="Guru",
    ),
)


BLACK_LEVEL_RAW_MAXIMUM = 255


def _set_exposure(camera: FeatureState, value: float) -> None:
    camera.settings.exposure_us = round(value)


EXPOSURE_LIMITS_US = (EXPOSURE_MINIMUM_US, EXPOSURE_MAXIMUM_US)
INSIDE_C = 45.0  # a camera warmed up on its mount; constant here
EXPOSURE_FEATURES = in_category(
    CONTROL,
    single_choice("ExposureMode", "Exposure mode.", "Timed"),
    single_choice("ExposureAuto", "Automatic exposure.", "Off"),
    Feature(
        "ExposureTimeAbs",
        "Exposure time.",
        Kind.FLOAT,
        read=lambda camera: camera.settings.exposure_us,
        write=_set_exposure,
        unit="us",
        limits=EXPOSURE_LIMITS_US,
    ),
    setting("ExposureTimeRaw", "Exposure time in time bases.", "exposure_us", limits=EXPOSURE_LIMITS_US),
    constant("ExposureTimeBaseAbs", "Step of the exposure time.", 1.0, kind=Kind.FLOAT, unit="us"),
    Feature(
        "ReadoutTimeAbs",
        "Read-out time of the current area.",
        Kind.FLOAT,
        read=lambda camera: readout_us(camera.settings.frame()),
        unit="us",
    ),
)
ANALOG_FEATURES = in_category(
    "AnalogControls",
    constant("TemperatureAbs", "Inside the camera.", INSIDE_C, kind=Kind.FLOAT, unit="C"),
    single_choice("GainAuto", "Automatic gain.", "Off"),
    single_choice("GainSelector", "Signal to which the gain applies.", "All", selects=("GainRaw",)),
    setting(
        "GainRaw", "Gain; 20 log10(value / 32) dB.", "gain_raw", limits=(GAIN_RAW_MINIMUM, GAIN_RAW_MAXIMUM)
    ),
    single_choice(
        "BlackLevelSelector", "Signal to which the black level applies.", "All", selects=("BlackLevelRaw",)
    ),
    setting(
        "BlackLevelRaw",
        "Value of a dark pixel, on a 10-bit scale.",
        "black_level_raw",
        limits=(0, BLACK_LEVEL_RAW_MAXIMUM),
    ),
)
