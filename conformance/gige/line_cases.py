"""Cases for the output line of a GigE Vision camera, which may switch a lamp or a laser."""

from __future__ import annotations

import time
from collections.abc import Callable

from conformance.case import HOST_TIME, OUTPUT, CaseList, NotShown, check
from conformance.gige.client import GigeFeatures
from conformance.gige.stream import GigeStream, start_acquisition
from conformance.gige.stream_cases import streams

OUTPUT_NAMES = ("Out1", "Line2", "Line3", "Line4")  # of this family, and of later ones
USER_OUTPUTS = ("UserOutput", "UserOutput1")
LONG_EXPOSURE_US = 300_000.0  # long enough to be seen from here
POLL_S, SEEN_LIMIT_S = 0.01, 2.0

CASES = CaseList()
on_stream = CASES.with_each(streams)


def select_output(features: GigeFeatures) -> None:
    """Select an output line; raises NotShown if the camera states none."""
    entries = features.entries("LineSelector") if features.has("LineSelector") else ()
    for name in filter(entries.__contains__, OUTPUT_NAMES):
        features.set("LineSelector", name)
        if features.get("LineMode") == features.entry("LineMode", "Output"):
            return
    raise NotShown(f"the camera has no output line among {', '.join(entries) or 'no lines'}")


def select_user_output(features: GigeFeatures) -> None:
    """Let the user output drive the selected line; raises NotShown if it cannot."""
    for name in filter(features.entries("LineSource").__contains__, USER_OUTPUTS):
        features.set("LineSource", name)
        return
    raise NotShown("the output line has no user output as its source")


@on_stream(
    "G41",
    "the output line follows its user output and its inverter, and LineStatus shows it",
    needs=(OUTPUT,),
)
def line_follows_user_output(stream: GigeStream) -> None:
    features = stream.features
    select_output(features)
    select_user_output(features)
    for inverted in (0, 1):
        features.set("LineInverter", inverted)
        for value in (1, 0):
            features.set("UserOutputValue", value)
            level = features.whole("LineStatus")
            check(
                level == value ^ inverted, f"level {value ^ inverted} for {value}, inverted {inverted}", level
            )


@on_stream(
    "G42",
    "an output line of source ExposureActive is high during the exposure only",
    needs=(OUTPUT, HOST_TIME),
)
def line_shows_exposure(stream: GigeStream) -> None:
    features = stream.features
    select_output(features)
    if "ExposureActive" not in features.entries("LineSource"):
        raise NotShown("the output line has no source ExposureActive")
    features.set("LineSource", "ExposureActive")
    features.set("LineInverter", 0)
    features.set("ExposureTimeAbs", LONG_EXPOSURE_US)
    start_acquisition(stream)
    check(not features.get("LineStatus"), "a low line before the trigger")
    stream.trigger()
    check(_becomes(lambda: bool(features.get("LineStatus"))), "a high line during the exposure")
    stream.frame()
    check(_becomes(lambda: not features.get("LineStatus")), "a low line after the exposure")


def _becomes(condition: Callable[[], bool]) -> bool:
    deadline_s = time.monotonic() + SEEN_LIMIT_S
    while not (true := condition()) and time.monotonic() < deadline_s:
        time.sleep(POLL_S)
    return true
