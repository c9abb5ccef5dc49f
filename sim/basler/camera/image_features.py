"""Features of the image: sensor, area of interest, pixel format, test images."""

from __future__ import annotations

from ronna_hw.wire.gige_vision import AREA_STEP_X_PX as STEP_X
from ronna_hw.wire.gige_vision import SENSOR_HEIGHT_PX, SENSOR_WIDTH_PX, PixelFormat
from sim.basler.camera.features import Feature, Kind, always, constant, setting
from sim.basler.camera.settings import RampImage, bits_per_pixel

PIXEL_SIZES = {"Bpp8": 8, "Bpp12": 12, "Bpp16": 16}
IMAGE = "ImageFormat"
IMAGE_FEATURES: tuple[Feature, ...] = (
    constant("SensorWidth", IMAGE, "Width of the sensor.", SENSOR_WIDTH_PX, unit="px"),
    constant("SensorHeight", IMAGE, "Height of the sensor.", SENSOR_HEIGHT_PX, unit="px"),
    constant("WidthMax", IMAGE, "Largest width.", SENSOR_WIDTH_PX, unit="px"),
    constant("HeightMax", IMAGE, "Largest height.", SENSOR_HEIGHT_PX, unit="px"),
    setting(
        "Width",
        IMAGE,
        "Width of the area of interest.",
        "width",
        minimum=always(STEP_X),
        maximum=lambda commands: SENSOR_WIDTH_PX - commands.settings.offset_x,
        step=STEP_X,
        unit="px",
        locked=True,
    ),
    setting(
        "Height",
        IMAGE,
        "Height of the area of interest.",
        "height",
        minimum=always(1),
        maximum=lambda commands: SENSOR_HEIGHT_PX - commands.settings.offset_y,
        unit="px",
        locked=True,
    ),
    setting(
        "OffsetX",
        IMAGE,
        "Column of the area's left edge; may change during an acquisition.",
        "offset_x",
        minimum=always(0),
        maximum=lambda commands: SENSOR_WIDTH_PX - commands.settings.width,
        step=STEP_X,
        unit="px",
    ),
    setting(
        "OffsetY",
        IMAGE,
        "Row of the area's upper edge; may change during an acquisition.",
        "offset_y",
        minimum=always(0),
        maximum=lambda commands: SENSOR_HEIGHT_PX - commands.settings.height,
        unit="px",
    ),
    setting(
        "PixelFormat",
        IMAGE,
        "Format of the pixels on the wire.",
        "pixel_format",
        kind=Kind.ENUMERATION,
        entries={
            "Mono8": PixelFormat.MONO8,
            "Mono12": PixelFormat.MONO12,
            "Mono12Packed": PixelFormat.MONO12_PACKED,
        },
        locked=True,
    ),
    Feature(
        "PixelSize",
        Kind.ENUMERATION,
        IMAGE,
        "Bits of a pixel on the wire.",
        read=lambda commands: bits_per_pixel(PixelFormat(commands.settings.pixel_format)),
        entries=PIXEL_SIZES,
    ),
    setting(
        "TestImageSelector",
        IMAGE,
        "A ramp instead of the sensor's image.",
        "test_image",
        kind=Kind.ENUMERATION,
        entries={"Off": RampImage.OFF, "Testimage1": RampImage.FIXED, "Testimage2": RampImage.MOVING},
    ),
)
