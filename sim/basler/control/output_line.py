"""Input and output line of the camera, and the line features that set them.

The output switches whatever is wired to it: the line projector of the stereo head, at the left camera.
"""

from __future__ import annotations

from ronna_hw.wire.gige_vision import GevStatus
from sim.basler.camera.features import Feature, FeatureState, Kind, choice, in_category, setting
from sim.basler.control.registers import RegisterRefusal
from sim.basler.settings import CameraSettings, Line, LineSource

INPUT, OUTPUT = 0, 1  # entries of LineMode


def exposure_level(settings: CameraSettings) -> bool:
    """Return the electrical level of the output line while a frame is exposed."""
    high = {
        LineSource.EXPOSURE_ACTIVE: True,
        LineSource.USER_OUTPUT: bool(settings.user_output_value),
    }.get(LineSource(settings.line_source), False)
    return high != bool(settings.lines_inverted[Line.OUT_1])


def line_level(camera: FeatureState, line: Line) -> bool:
    """Return the present level of a line; pulses on the input are too short to be read."""
    settings, acquisition = camera.settings, camera.acquisition
    high = False
    if line is Line.OUT_1:
        high = {
            LineSource.EXPOSURE_ACTIVE: acquisition.is_exposing,
            LineSource.FRAME_TRIGGER_WAIT: acquisition.awaits_trigger,
            LineSource.ACQUISITION_TRIGGER_WAIT: acquisition.awaits_permission,
            LineSource.USER_OUTPUT: bool(settings.user_output_value),
        }[LineSource(settings.line_source)]
    inverted = bool(settings.lines_inverted[line])
    return high != inverted and not (line is Line.OUT_1 and camera.output_held_low)


def _selected(camera: FeatureState) -> Line:
    return Line(camera.settings.line_selector)


def _invert(camera: FeatureState, value: int) -> None:
    settings, selected = camera.settings, _selected(camera)
    one, other = (value if line is selected else settings.lines_inverted[line] for line in Line)
    settings.lines_inverted = (one, other)


def _set_source(camera: FeatureState, value: int) -> None:
    if _selected(camera) is not Line.OUT_1:
        raise RegisterRefusal(GevStatus.ACCESS_DENIED)  # an input has no source
    camera.settings.line_source = value


LINE_FEATURES = in_category(
    "DigitalIO",
    choice(
        "LineSelector",
        "Line to which the following features apply.",
        "line_selector",
        entries={"Line1": Line.LINE_1, "Out1": Line.OUT_1},
        selects=("LineMode", "LineSource", "LineInverter", "LineStatus"),
    ),
    Feature(
        "LineMode",
        "Direction of the selected line.",
        Kind.ENUMERATION,
        read=lambda camera: OUTPUT if _selected(camera) is Line.OUT_1 else INPUT,
        entries={"Input": INPUT, "Output": OUTPUT},
    ),
    Feature(
        "LineSource",
        "Signal on the selected output.",
        Kind.ENUMERATION,
        read=lambda camera: camera.settings.line_source,
        write=_set_source,
        entries={
            "ExposureActive": LineSource.EXPOSURE_ACTIVE,
            "FrameTriggerWait": LineSource.FRAME_TRIGGER_WAIT,
            "AcquisitionTriggerWait": LineSource.ACQUISITION_TRIGGER_WAIT,
            "UserOutput": LineSource.USER_OUTPUT,
        },
    ),
    Feature(
        "LineInverter",
        "Inverts the selected line.",
        Kind.BOOLEAN,
        read=lambda camera: camera.settings.lines_inverted[_selected(camera)],
        write=_invert,
    ),
    Feature(
        "LineStatus",
        "Present level of the selected line.",
        Kind.BOOLEAN,
        read=lambda camera: int(line_level(camera, _selected(camera))),
    ),
    choice(
        "UserOutputSelector",
        "User output that UserOutputValue sets.",
        "user_output_selector",
        entries={"UserOutput1": 1},
        selects=("UserOutputValue",),
    ),
    setting(
        "UserOutputValue",
        "Value of the selected user output.",
        "user_output_value",
        kind=Kind.BOOLEAN,
    ),
)
