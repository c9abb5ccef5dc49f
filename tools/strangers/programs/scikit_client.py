"""scikit-surgerynditracker, as its documentation uses it."""

from __future__ import annotations

import os
import sys
from contextlib import redirect_stdout
from typing import Any

import numpy as np
from simulated_peer import address, clear, eventually, inject
from sksurgerynditracker.nditracker import NDITracker  # type: ignore[import-untyped]

ROMS = os.environ["ROMS"].split(os.pathsep)


def tracking(tools: int, **more: Any) -> Any:
    host, port = address("LINE")
    settings = {"tracker type": "vega", "ip address": host, "port": port, "romfiles": ROMS[:tools], **more}
    return started(settings)


def started(settings: dict[str, Any]) -> Any:
    with redirect_stdout(sys.stderr):
        tracker = NDITracker(settings)
    tracker.start_tracking()
    return tracker


def places(tracker: Any) -> list[Any]:
    *_, poses, _ = tracker.get_frame()
    return [pose[:3, 3] for pose in poses]


def are_in_place(found: list[Any]) -> bool:
    true = [(-150.0, -300.0 + 200.0 * number, -1500.0) for number in range(len(found))]
    return bool(np.abs(np.array(found) - true).max() < 1.0)


def connects_by_network() -> None:
    tracking(1)


def connects_by_serial_line() -> None:
    path = os.environ["LINE"].removeprefix("serial://")
    tracker = started({"tracker type": "polaris", "serial port": path, "romfiles": ROMS[:1]})
    assert are_in_place(places(tracker))


def reads_a_tool_as_binary() -> None:
    tracker = tracking(1)
    assert tracker._capture_string.startswith("BX")
    assert are_in_place(places(tracker))


def reads_a_tool_as_text() -> None:
    tracker = tracking(1)
    assert tracker._capture_string.startswith("TX"), "it asks in binary although its list names this firmware"
    assert are_in_place(places(tracker))


def reads_three_tools_as_binary() -> None:
    tracker = tracking(3)
    assert tracker._capture_string.startswith("BX")
    assert all(are_in_place(places(tracker)) for _ in range(200))


def reads_three_tools_as_text() -> None:
    tracker = tracking(3)
    assert tracker._capture_string.startswith("TX")
    assert all(are_in_place(places(tracker)) for _ in range(200))


def says_that_a_tool_is_hidden() -> None:
    tracker = tracking(2)
    inject("tracker hide tool 1")
    assert eventually(lambda: np.isnan(places(tracker)[0]).all()), "a hidden tool has a pose"
    assert np.isfinite(places(tracker)[1]).all(), "the other tool is missing too"
    clear()
    assert eventually(lambda: are_in_place(places(tracker)))


def says_that_a_tool_is_hidden_when_it_averages() -> None:
    tracker = tracking(1, **{"smoothing buffer": 30})
    for _ in range(30):
        tracker.get_frame()
    inject("tracker hide tool 1")
    while tracker._get_transform(tracker._device, b"\x01") != "MISSING":
        *_, poses, _errors_mm = tracker.get_frame()
    assert np.isnan(poses[0][:3, 3]).any(), "a hidden tool has a pose: the mean of those before"


def reads_frame_numbers() -> None:
    tracker = tracking(1)
    first = tracker.get_frame()[2][0]
    assert eventually(lambda: first < tracker.get_frame()[2][0] < first + 1000)


def refuses_garbled_replies() -> None:
    tracker = tracking(1)
    inject("tracker garble replies 100 %")
    try:
        tracker.get_frame()
    except OSError:
        return
    raise AssertionError("a garbled reply passes for a good one")


def survives_noise_on_the_line() -> None:
    tracker = tracking(1)
    inject("tracker garble replies 50 %")
    for _ in range(300):
        try:
            tracker.get_frame()
        except OSError:
            continue
    clear()
    assert are_in_place(places(tracker))


def gives_up_when_no_reply_comes() -> None:
    tracker = tracking(1)
    inject("tracker lose replies 100 %")
    try:
        tracker.get_frame()
    except OSError:
        return
    raise AssertionError("no reply passes for one")


def tells_that_the_unit_was_bumped() -> None:
    tracker = tracking(1)
    inject("tracker bump")
    assert eventually(lambda: np.isnan(places(tracker)[0]).all())
    raise AssertionError("the alert looks like a hidden tool: get_frame() has no system status")
