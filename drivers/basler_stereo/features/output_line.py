"""Output line of a camera that switches the line projector, by the names of its features."""

from __future__ import annotations

from collections.abc import Collection

from drivers.basler_stereo.errors import NO_OUTPUT_LINE, OUTPUT_STUCK
from drivers.basler_stereo.features.known_state import Features
from drivers.basler_stereo.options import ProjectorOptions
from ronna_hw.errors import RonnaError

USER_OUTPUTS = ("UserOutput", "UserOutput1")  # this family's name of the source, and that of later ones
EXPOSURE = "ExposureActive"
OUTPUT = "Output"


def prepare_projector(features: Features, projector: ProjectorOptions, camera: str) -> None:
    """Make the line an output and switch the projector off; `camera` is the name used in messages.

    Raises GEV-020 for a line or source that the camera lacks, GEV-021 if the line does not go off.
    """
    missing = missing_line(list_lines(features), projector.line, camera)
    if missing:
        raise NO_OUTPUT_LINE(missing)
    features.choose("LineSelector", projector.line)
    if features.choice("LineMode") != OUTPUT:
        try:
            features.choose("LineMode", OUTPUT)
        except RonnaError as error:
            raise NO_OUTPUT_LINE(
                f"{projector.line} of the {camera} is an input", expected="an output line"
            ) from error
    if not features.has("LineStatus"):
        raise NO_OUTPUT_LINE(f"{projector.line} of the {camera} cannot be read back", expected="LineStatus")
    _find_source(features, projector, camera, on=True)  # before anything is lit
    features.set_number("LineInverter", projector.inverted)  # the vendor's library takes no integer
    switch_projector(features, projector, camera, on=False)


def switch_projector(features: Features, projector: ProjectorOptions, camera: str, *, on: bool) -> None:
    """Switch the projector and read the line back; raises GEV-021 if it does not follow.

    With the source ExposureActive the line is low between exposures, also while the projector is on. A scan
    switches hundreds of times, and each register takes a packet there and one back: only what may differ is
    written.
    """
    source = _find_source(features, projector, camera, on=on)
    lit_now = on and source != EXPOSURE
    if source != EXPOSURE:
        _select_output(features)
        features.set_number("UserOutputValue", lit_now)
    if features.choice("LineSource") != source:
        features.choose("LineSource", source)
        if (found := features.choice("LineSource")) != source:
            raise OUTPUT_STUCK(
                f"{projector.line} of the {camera} keeps its source", expected=source, got=found
            )
    level = bool(features.number("LineStatus"))
    if source != EXPOSURE and level != (lit_now != projector.inverted):
        raise OUTPUT_STUCK(
            f"{projector.line} of the {camera} is {_level(level)} with the projector {'on' if on else 'off'}",
            expected=_level(not level),
            got=_level(level),
        )


def list_lines(features: Features) -> tuple[str, ...]:
    """Return the names of the camera's lines."""
    return tuple(features.entries("LineSelector")) if features.has("LineSelector") else ()


def missing_line(lines: Collection[str], wanted: str, camera: str) -> str:
    """Say which lines a camera has when `wanted` is not among them, else nothing."""
    if wanted in lines:
        return ""
    return f"the {camera} has no line {wanted}, only {', '.join(lines) or 'none at all'}"


def _select_output(features: Features) -> None:
    """Select the first of several user outputs; a single one is selected already."""
    if (
        features.has("UserOutputSelector")
        and len(outputs := tuple(features.entries("UserOutputSelector"))) > 1
    ):
        features.choose("UserOutputSelector", outputs[0])


def _find_source(features: Features, projector: ProjectorOptions, camera: str, *, on: bool) -> str:
    """Select the line; return the entry of LineSource, always the user output while the projector is off."""
    features.choose("LineSelector", projector.line)
    offered = tuple(features.entries("LineSource"))
    wanted = USER_OUTPUTS if not on or projector.source != EXPOSURE else (EXPOSURE,)
    for source in wanted:
        if source in offered:
            return source
    raise NO_OUTPUT_LINE(
        f"{projector.line} of the {camera} has no source {wanted[0]}", expected=" or ".join(offered)
    )


def _level(high: bool) -> str:
    return "high" if high else "low"
