"""The x-shaped frame on the head as a tool of the tracker: its spheres are then no strays.

A tracker that has its definition loaded reports one pose. What watches the spheres on the head is not to
care: the markers of that pose join the strays. Where the unit finds no pose, its spheres are strays anyway.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from procedures.workcell.device_views import TrackerView
from ronna_hw.devices.readings import StrayReading, TrackerFrame, Validity
from ronna_hw.frames import Frame
from ronna_hw.x_frame import SPHERE_CENTRES_MM

ALIKE_MM = 0.05  # between a loaded definition and the frame: a definition is text of two digits


def name_of_frame(markers_mm: Mapping[str, Sequence[Sequence[float]]]) -> str | None:
    """The tool whose markers are those of the x-shaped frame, in its order; None without one."""
    frame = np.array(SPHERE_CENTRES_MM)
    for name, markers in markers_mm.items():
        if np.shape(markers) == frame.shape and np.abs(np.array(markers) - frame).max() <= ALIKE_MM:
            return name
    return None


def with_its_spheres(tracker: TrackerView, frame: TrackerFrame) -> TrackerFrame:
    """The reading with the spheres of the frame on the head among its strays, where it is seen as a tool."""
    name = name_of_frame(tracker.markers_mm)
    if name is None or (reading := frame.tool(name)).validity is not Validity.OK:
        return frame
    places = reading.transform(Frame.TRACKER, Frame.MARKER).apply(tracker.markers_mm[name]).tolist()
    more = tuple(StrayReading((x, y, z), Validity.OK) for x, y, z in places)
    return replace(frame, strays=(*frame.strays, *more))
