"""Readings of a run as tables: stray markers with their identity, and looks with their pictures."""

from __future__ import annotations

import operator
from base64 import b64encode
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from procedures.engine.errors import NotRecorded
from procedures.engine.replay.recorded_answers import describe_torn_end
from procedures.exchange.errors import NoSuchLook
from procedures.exchange.raw_readings import iterate_steps
from ronna_hw.arguments import WrongArgument, show
from ronna_hw.bounded_input import InputRefused
from ronna_hw.devices.readings import CameraImage, StereoReading, TrackerFrame, Validity
from ronna_hw.devices.stray_tracks import identify_strays
from ronna_hw.loaded_run import RunColumn, RunTable, StereoPictures
from ronna_hw.text import format_count

STRAYS = (
    RunColumn("frame", int, "number of the tracker frame in the run, from 0"),
    RunColumn("step", str, "step that read it"),
    RunColumn("theatre_time_s", float, "theatre time of its arrival"),
    RunColumn("device_clock", int, "the tracker's own count of frames"),
    RunColumn("identity", int, "the same sphere over the frames; -1 where it cannot be told"),
    RunColumn("position_tracker_mm", float, "as measured", (3,)),
    RunColumn("validity", str, "`ok`, or why the tracker doubts it"),
)
LOOKS = (
    RunColumn("look", int, "number of the look in the run, from 0: its place in `pictures`"),
    RunColumn("step", str, "step that took it"),
    RunColumn("theatre_time_s", float, "theatre time of its arrival"),
    RunColumn("device_clock", int, "ticks of the left camera's clock"),
    RunColumn("validity", str, "`ok`, or what is missing"),
    RunColumn("left_offset_px", int, "top-left pixel of the left picture on its sensor", (2,)),
    RunColumn("right_offset_px", int, "top-left pixel of the right picture on its sensor", (2,)),
)
WIDEST_PX = 480  # of a picture in a notebook; two fit beside each other
NO_OFFSET_PX = (-1, -1)  # of a picture that did not arrive


class ShownPictures(StereoPictures):
    """Pictures of one look that a notebook shows."""

    def _repr_html_(self) -> str:
        """Return both pictures side by side, from black to the brightest pixel of each."""
        shown = (_picture_html(side, pixels) for side, pixels in self._asdict().items() if pixels is not None)
        return f"<pre>{escape(repr(self))}</pre>{''.join(shown)}"


def _picture_html(side: str, pixels: NDArray[Any]) -> str:
    import cv2  # for notebooks alone

    step = -(-pixels.shape[1] // WIDEST_PX)
    small = pixels[::step, ::step]
    grey = (small * (255.0 / max(int(small.max(initial=1)), 1))).astype(np.uint8)
    _, content = cv2.imencode(".png", grey)
    source = f"data:image/png;base64,{b64encode(content.tobytes()).decode()}"
    return f'<img alt="{side}" title="{side}" src="{source}">'


class RecordedPictures(Sequence[StereoPictures]):
    """Pictures of each look, read from the run's tape when they are asked for."""

    def __init__(self, loaders: Sequence[Callable[[], object]]) -> None:
        self._loaders = loaders

    def __len__(self) -> int:
        return len(self._loaders)

    def __repr__(self) -> str:
        return f"<pictures of {format_count(len(self), 'look')}: pictures[0].left is the first left one>"

    @overload
    def __getitem__(self, index: int) -> StereoPictures: ...
    @overload
    def __getitem__(self, index: slice) -> RecordedPictures: ...
    def __getitem__(self, index: int | slice) -> StereoPictures | RecordedPictures:
        """Return the pictures of one image pair, or of several.

        Raises ARG-001 for what is no number, EXC-006, and PRO-024 for damaged pixels.
        """
        if isinstance(index, slice):
            return RecordedPictures(self._loaders[index])
        try:
            index = operator.index(index)
        except TypeError as error:
            raise WrongArgument(
                "the look is no number", got=show(index), action="run.pictures[0].left is the first left one."
            ) from error
        if not self._loaders:
            raise NoSuchLook(
                "there are no pictures: no readings of the stereo head",
                action="run.notes says which readings of the run are missing.",
            )
        if not -len(self) <= index < len(self):
            raise NoSuchLook(f"there is no look {index}", expected=f"0 to {len(self) - 1}")
        pair = self._loaders[index]()
        assert isinstance(pair, StereoReading)
        return ShownPictures(*(None if one is None else one.pixels for one in (pair.left, pair.right)))


@dataclass(frozen=True)
class RecordedTables:
    """Readings of a run: its stray markers, its looks with their pictures, and what is missing in them."""

    strays: RunTable
    looks: RunTable
    pictures: RecordedPictures
    gaps: tuple[str, ...]


def recorded_tables(run: Path) -> RecordedTables:
    """Read the tape of a run without its damaged readings. One pass; pictures stay on the disk."""
    frames: list[tuple[str, TrackerFrame]] = []
    looks: list[tuple[object, ...]] = []
    loaders: list[Callable[[], object]] = []
    damaged: list[str] = []
    gaps: list[str] = []
    try:
        for step, one in iterate_steps(run):
            if one.kind not in (TrackerFrame, StereoReading):
                continue
            try:
                value = one.load()
            except NotRecorded as error:
                damaged.append(f"{error.code}: {error.summary}")
                continue
            if isinstance(value, TrackerFrame) and value.validity is not Validity.STALE:
                frames.append((step, value))
            elif isinstance(value, StereoReading):
                stamp = value.stamp
                taken = (len(looks), step, stamp.theatre_time_s, stamp.device_clock, value.validity.value)
                looks.append((*taken, _offset_px(value.left), _offset_px(value.right)))
                loaders.append(one.load)
        gaps += filter(None, [describe_torn_end(run)])
    except (NotRecorded, InputRefused) as error:
        gaps.append(f"the readings end early: {error.code}: {error.summary}")
    if damaged:
        gaps.append(f"{format_count(len(damaged), 'damaged reading')} left out; the first: {damaged[0]}")
    return RecordedTables(_strays(frames), RunTable.of(LOOKS, looks), RecordedPictures(loaders), tuple(gaps))


def _strays(frames: Sequence[tuple[str, TrackerFrame]]) -> RunTable:
    identities = identify_strays([[stray.position_mm for stray in frame.strays] for _, frame in frames])
    rows: list[tuple[object, ...]] = []
    for number, (step, frame) in enumerate(frames):
        read = (number, step, frame.stamp.theatre_time_s, frame.stamp.device_clock)
        for identity, stray in zip(identities[number].tolist(), frame.strays, strict=True):
            rows.append((*read, identity, stray.position_mm, stray.validity.value))
    return RunTable.of(STRAYS, rows)


def _offset_px(image: CameraImage | None) -> tuple[int, int]:
    return NO_OFFSET_PX if image is None else (image.area.offset_x, image.area.offset_y)
