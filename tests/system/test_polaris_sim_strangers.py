"""The tracker simulator driven by clients that we did not write."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from ronna_hw.child_process import ChildProcess, command
from sim.polaris.definition import write_definition
from sim.theatre.built_in import built_in_scene, robot_frame
from sim.theatre.scene import TrackerTool

ndicapy = pytest.importorskip("ndicapy")

POINTER = TrackerTool(
    name="pointer",
    part_number="8700340",
    markers_mm=((0.0, 0.0, 0.0), (0.0, 50.0, 0.0), (25.0, 100.0, 0.0), (-25.0, 135.0, 0.0)),
)
FRAMES = 60
TRACKING_LIMIT_S = 20.0
PAUSE_S = 0.004  # several requests per frame, without keeping a core busy


@pytest.fixture
def roms(tmp_path: Path) -> list[Path]:
    """Definition files of two tools."""
    files = []
    for tool in (robot_frame(), POINTER):
        files.append(tmp_path / f"{tool.name}.rom")
        files[-1].write_bytes(write_definition(tool))
    return files


@pytest.fixture(params=["serial-pty", "tcp://127.0.0.1:0"])
def endpoint(request: pytest.FixtureRequest) -> Iterator[str]:
    """Where a simulator waits."""
    with ChildProcess(
        "ronna-sim polaris", command("sim.cli", "polaris", "--endpoint", request.param)
    ) as child:
        yield child.ready["endpoint"]


def open_device(endpoint: str) -> object:
    if endpoint.startswith("serial://"):
        path = endpoint.removeprefix("serial://")
        assert ndicapy.ndiProbe(path) == ndicapy.NDI_OKAY
        return ndicapy.ndiOpen(path)
    return ndicapy.ndiOpenNetwork("127.0.0.1", int(endpoint.rsplit(":", 1)[1]))


def test_ndicapi_loads_tools_and_tracks_them_by_text_and_by_bytes(endpoint: str, roms: list[Path]) -> None:
    device = open_device(endpoint)

    def send(line: str) -> str:
        reply: str = ndicapy.ndiCommand(device, line)
        assert ndicapy.ndiGetError(device) == ndicapy.NDI_OKAY
        return reply

    assert send("INIT:") == "OKAY"
    if endpoint.startswith("serial://"):
        assert send("COMM:50000") == "OKAY"
    assert "Polaris Spectra" in send("VER:4")
    handles = []
    for rom in roms:
        send("PHRQ:*********1****")
        handle = ndicapy.ndiGetPHRQHandle(device)
        ndicapy.ndiPVWRFromFile(device, handle, str(rom))
        assert send(f"PINIT:{handle:02X}") == "OKAY"
        assert send(f"PENA:{handle:02X}D") == "OKAY"
        handles.append(bytes([handle]))
    send("PHSR:04")
    assert ndicapy.ndiGetPHSRNumberOfHandles(device) == 2
    scene = built_in_scene("bench")

    assert send("TSTART:80") == "OKAY"
    getters = {
        "TX:1801": (ndicapy.ndiGetTXTransform, ndicapy.ndiGetTXFrame, ndicapy.ndiGetTXPassiveStray),
        "BX:1801": (ndicapy.ndiGetBXTransform, ndicapy.ndiGetBXFrame, ndicapy.ndiGetBXPassiveStray),
    }
    for request, (transform_of, frame_of, stray_of) in getters.items():
        numbers: set[int] = set()
        deadline = time.monotonic() + TRACKING_LIMIT_S
        while len(numbers) < FRAMES and time.monotonic() < deadline:
            ndicapy.ndiCommand(device, request)
            numbers.add(frame_of(device, handles[0]))
            assert frame_of(device, handles[1]) in numbers
            time.sleep(PAUSE_S)
        assert len(numbers) == FRAMES
        for handle, place in zip(handles, scene.tracker.places, strict=False):
            values = transform_of(device, handle)
            assert np.linalg.norm(values[:4]) == pytest.approx(1.0, abs=1e-3)
            assert values[4:7] == pytest.approx(place.translation_mm, abs=1.0)
            assert 0.0 <= values[7] < 1.0
        strays = np.array([stray_of(device, k) for k in range(3)])
        for truth in scene.tracker.strays_mm:
            assert np.linalg.norm(strays - truth, axis=1).min() < 1.5

    with pytest.raises(OSError, match="0x0c"):
        send("PHSR:00")
    assert send("TSTOP:") == "OKAY"
    with pytest.raises(OSError, match="0x0c"):
        send("TX:0001")
    with pytest.raises(OSError, match="0x2b"):
        send("PHF:7F")
    with pytest.raises(OSError, match="0x01"):
        send("NONSENSE:")
    for handle in handles:
        assert send(f"PHF:{handle[0]:02X}") == "OKAY"
    if endpoint.startswith("serial://"):
        assert send("COMM:00000") == "OKAY"
        ndicapy.ndiClose(device)
    else:
        ndicapy.ndiCloseNetwork(device)


@pytest.mark.parametrize("endpoint", ["serial-pty"], indirect=True)
def test_scikit_surgery_tracks_two_tools(endpoint: str, roms: list[Path]) -> None:
    nditracker = pytest.importorskip("sksurgerynditracker.nditracker")
    tracker = nditracker.NDITracker(
        {
            "tracker type": "polaris",
            "serial port": endpoint.removeprefix("serial://"),
            "romfiles": [str(rom) for rom in roms],
        }
    )
    tracker.start_tracking()
    places = built_in_scene("bench").tracker.places
    numbers = set()
    for _ in range(50):
        _, _, frame_numbers, poses, qualities = tracker.get_frame()
        numbers.update(frame_numbers)
        for pose, place in zip(poses, places, strict=False):
            assert pose[:3, 3] == pytest.approx(place.translation_mm, abs=1.0)
        assert max(qualities) < 1.0
    tracker.stop_tracking()
    tracker.close()
