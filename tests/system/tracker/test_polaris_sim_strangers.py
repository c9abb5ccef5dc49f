"""The tracker simulator driven by third-party clients, each in its own process."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tracker_strangers import NdicapiError, NdicapiHost, scikit_frames

from ronna_hw.control_port import ask_control_port
from ronna_hw.host.child_process import ChildProcess, command
from sim.polaris.unit.tool_definition import write_definition
from sim.world.process import load_scene
from sim.world.scene.model import TrackerTool
from sim.world.scene.named_scenes import draw_scene, robot_frame
from sim.world.world import World

pytest.importorskip("ndicapy")

PTY, TCP = "serial-pty", "tcp://127.0.0.1:0"
SLOW_TCP = pytest.param(TCP, marks=pytest.mark.slow)  # the client reads the same bytes from both
SCENE = draw_scene("bench")
STRAYS = len(SCENE.tracker.strays_mm)
# Three planar tools whose 18 segments differ by 3 mm and more, and triangles, which a unit finds too alike.
TOOLS = (
    robot_frame(),
    TrackerTool(
        name="pointer",
        part_number="8700340",
        markers_mm=((0.0, 0.0, 0.0), (0.0, 50.0, 0.0), (25.0, 100.0, 0.0), (-25.0, 135.0, 0.0)),
    ),
    TrackerTool(
        name="probe",
        part_number="PROBE",
        markers_mm=((0.0, 0.0, 0.0), (0.0, 95.0, 0.0), (59.0, 38.0, 0.0), (-46.0, 119.0, 0.0)),
    ),
    *(
        TrackerTool(
            name=f"triangle{side:g}",
            part_number=f"T{side:g}",
            markers_mm=((0.0, 0.0, 0.0), (0.0, side, 0.0), (0.6 * side, 0.3 * side, 0.0)),
        )
        for side in (66.0, 78.0, 114.0)
    ),
)
FRAMES = 100
BIAS_LIMIT_MM = 1.0  # four times the root mean square of the unit's bias field
REPEATABILITY_LIMIT_MM = 0.5  # of a fitted tool: single markers repeat to 0.04 mm across and 0.14 mm in depth
TX_STEP_MM, TX_STEP = 0.01, 1e-4  # what one digit of a TX reply is worth
PROBE_LIMIT_S = 4.0


@pytest.fixture(scope="module")
def roms(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Definition files of all tools."""
    folder = tmp_path_factory.mktemp("roms")
    files = []
    for tool in TOOLS:
        files.append(folder / f"{tool.name}.rom")
        files[-1].write_bytes(write_definition(tool))
    return files


@pytest.fixture(scope="module", params=[PTY, TCP], ids=["pty", "tcp"])
def waiting_unit(request: pytest.FixtureRequest) -> Iterator[str]:
    """A unit whose time passes only with its frames: each request gets the next one."""
    world = World.create(load_scene("bench"), paced=False)
    arguments = command("sim.cli", "polaris", "--endpoint", request.param, "--world", world.endpoint)
    with ChildProcess("ronna-sim polaris", arguments) as child:
        yield child.ready["endpoint"]


@contextmanager
def started(endpoint: str) -> Iterator[dict[str, Any]]:
    """What the READY line of a unit says that was started alone and keeps to the host's clock."""
    with ChildProcess("ronna-sim polaris", command("sim.cli", "polaris", "--endpoint", endpoint)) as child:
        yield child.ready


@pytest.fixture(scope="module", params=[PTY, SLOW_TCP], ids=["pty", "tcp"])
def unit(request: pytest.FixtureRequest) -> Iterator[dict[str, Any]]:
    """A unit that the tests of this file share."""
    with started(request.param) as ready:
        yield ready


@pytest.fixture(params=[PTY, SLOW_TCP], ids=["pty", "tcp"])
def fresh_unit(request: pytest.FixtureRequest) -> Iterator[dict[str, Any]]:
    """A unit that has heard no command: which bits a bad line turns over is settled by their number."""
    with started(request.param) as ready:
        yield ready


def begun(endpoint: str) -> NdicapiHost:
    """ndicapi on a unit in setup, nothing loaded, that measures as often as it can."""
    host = NdicapiHost(endpoint, probe=False)
    assert host.command("INIT:") == "OKAY"
    assert host.command("SET:Param.Tracking.Illuminator Rate=2") == "OKAY"
    return host


@contextmanager
def fault(unit: dict[str, Any], line: str) -> Iterator[None]:
    """Something is wrong with the unit from now on, and all is well again afterwards."""
    ask_control_port(unit["control"], "fault", line=f"now: {line}")
    try:
        yield
    finally:
        ask_control_port(unit["control"], "clear_faults")


@pytest.mark.parametrize("unit", [PTY], ids=["pty"], indirect=True)
def test_ndicapi_finds_the_unit_by_probing_the_line(unit: dict[str, Any]) -> None:
    def probe_s() -> float:
        began_s = time.monotonic()
        with NdicapiHost(unit["endpoint"]) as host:
            assert host.probed == 0
            assert host.command("INIT:") == "OKAY"
            assert "Polaris Spectra" in host.command("VER:4")
        return time.monotonic() - began_s

    # Without OKAY in 0.2 s it sends a break and waits for seconds: once may be the machine's fault.
    assert min(probe_s() for _ in range(2)) < PROBE_LIMIT_S


@pytest.mark.parametrize(
    ("waiting_unit", "count"),
    [
        pytest.param(endpoint, count, id=f"{name}-{count}", marks=marks)
        for endpoint, name, count, marks in (
            (TCP, "tcp", 1, pytest.mark.slow),
            (PTY, "pty", 3, ()),
            (TCP, "tcp", len(TOOLS), ()),
            (PTY, "pty", 1, pytest.mark.slow),
            (TCP, "tcp", 3, pytest.mark.slow),
            (PTY, "pty", len(TOOLS), pytest.mark.slow),
        )
    ],
    indirect=["waiting_unit"],
)
def test_tools_and_strays_are_at_their_true_positions_in_text_and_binary_replies(
    waiting_unit: str, roms: list[Path], count: int
) -> None:
    with begun(waiting_unit) as host:
        handles = host.load(*roms[:count])
        assert host.ask("handles", line="PHSR:04") == handles == list(range(1, count + 1))
        seen = {}
        for line in ("TX:1801", "BX:1801"):
            assert host.command("TSTART:80") == "OKAY"  # from frame zero
            seen[line] = host.track(line, handles, FRAMES)
            assert host.command("TSTOP:") == "OKAY"
        for frames in seen.values():
            assert [frame["number"] for frame in frames] == list(range(1, FRAMES + 1))
            assert all(frame["one_frame"] and frame["system"] == 0 for frame in frames)
            assert {status for frame in frames for status in frame["status"]} == {0x31}
            assert {len(frame["strays"]) for frame in frames} == {STRAYS}
            tools = np.array([frame["tools"] for frame in frames])  # (frames, tools, 8)
            assert np.linalg.norm(tools[..., :4], axis=-1) == pytest.approx(1.0, abs=1e-3)
            assert (tools[..., 7] >= 0.0).all()
            assert tools[..., 7].max() < 1.0
            places = np.array([place.translation_mm for place in SCENE.tracker.places[:count]])
            assert np.linalg.norm(tools[..., 4:7].mean(axis=0) - places, axis=1).max() < BIAS_LIMIT_MM
            assert 0.0 < tools[..., 4:7].std(axis=0).max() < REPEATABILITY_LIMIT_MM
            assert np.abs(tools[..., 1:4].mean(axis=0)).max() < 0.02  # all stand square to the unit
            strays = np.array([frame["strays"] for frame in frames])  # in another order in every frame
            for truth in SCENE.tracker.strays_mm:
                assert np.linalg.norm(strays - truth, axis=-1).min(axis=1).max() < 2.0 * BIAS_LIMIT_MM


def test_line_noise_reaches_the_client_as_errors_and_tracking_continues(
    fresh_unit: dict[str, Any], roms: list[Path]
) -> None:
    with begun(fresh_unit["endpoint"]) as host:
        handles = host.load(roms[0])
        assert host.command("TSTART:80") == "OKAY"
        # A wrong bit in the colon makes another form of command of it: an unknown one, then. The highest bit
        # of a reply must stay: ndicapi 3.7 reads outside its CRC table on a negative character, and dies.
        wrong = pytest.raises(NdicapiError, match=r"POLARIS 0x0[14]")
        with fault(fresh_unit, "tracker garble commands 100 %"), wrong:
            host.command("TX:0001")
        with (
            fault(fresh_unit, "tracker garble replies 100 %"),
            pytest.raises(NdicapiError, match="Error 0x0100"),
        ):
            host.command("TX:0001")
        assert len(host.track("TX:1801", handles, 3)) == 3


def test_each_error_of_the_unit_reaches_the_client_with_its_own_code(
    waiting_unit: str, roms: list[Path]
) -> None:
    with begun(waiting_unit) as host:

        def refused(line: str) -> str:
            with pytest.raises(NdicapiError) as caught:
                host.command(line)
            return str(caught.value).split(":")[0]

        assert refused("NONSENSE:") == "POLARIS 0x01"
        assert refused("PHF:7F") == "POLARIS 0x2b"
        assert refused("TX:0001") == "POLARIS 0x0c"
        assert refused("BX:0001") == "Error 0x0100"  # ndicapi looks for a binary CRC in the text
        assert refused("GET:No.Such.Name") == "POLARIS 0x34"
        assert refused("SET:Features.Hardware.Model=Vega") == "POLARIS 0x39"
        host.command("PHRQ:*********1****")
        assert refused("PINIT:01") == "POLARIS 0x0d"  # nothing has been loaded
        assert refused("PENA:01D") == "POLARIS 0x0e"
        assert host.command("PHF:01") == "OKAY"
        corrupt = roms[0].with_name("corrupt.rom")
        content = bytearray(roms[0].read_bytes())
        content[100] ^= 1
        corrupt.write_bytes(content)
        with pytest.raises(NdicapiError, match=r"POLARIS 0x(13|40)"):
            host.load(corrupt)
        assert host.command("PHF:01") == "OKAY"
        (handle,) = host.load(roms[0])
        assert host.command("TSTART:") == "OKAY"
        assert refused("PHSR:00") == "POLARIS 0x0c"
        assert refused("TSTART:") == "POLARIS 0x0c"
        assert refused(f"PENA:{handle:02X}D") == "POLARIS 0x0c"
        assert host.track("BX:0801", [handle], 1)[0]["tools"][0][6] < 0.0  # none of it stopped the tracking
        assert host.command("TSTOP:") == "OKAY"
        assert refused("TX:0001") == "POLARIS 0x0c"


def test_the_unit_serves_the_next_client_after_one_was_killed(unit: dict[str, Any], roms: list[Path]) -> None:
    first = begun(unit["endpoint"])
    handles = first.load(*roms[:3])
    assert first.command("TSTART:80") == "OKAY"
    first.begin("track", line="BX:1801", handles=handles, frames=1_000_000)
    time.sleep(0.05)  # somewhere in the middle of a reply
    first.kill()
    with begun(unit["endpoint"]) as second:
        assert second.ask("handles", line="PHSR:00") == []
        handles = second.load(roms[1])
        assert second.command("TSTART:80") == "OKAY"
        assert len(second.track("BX:1801", handles, 5)) == 5
        assert second.command("TSTOP:") == "OKAY"


def test_scikit_surgery_tracks_two_tools(
    waiting_unit: str, roms: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("sksurgerynditracker")
    ping = tmp_path / "ping"  # it pings a network unit first, and this machine need not have that program
    ping.write_text("#!/bin/sh\nexit 0\n")
    ping.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    wanted: dict[str, Any] = {"romfiles": [str(rom) for rom in roms[:2]]}
    if waiting_unit.startswith("serial://"):
        wanted |= {"tracker type": "polaris", "serial port": waiting_unit.removeprefix("serial://")}
    else:
        port = int(waiting_unit.rpartition(":")[2])
        wanted |= {"tracker type": "vega", "ip address": "127.0.0.1", "port": port}
    frames = scikit_frames(wanted, FRAMES)
    assert [frame["numbers"][0] for frame in frames] == [frame["numbers"][1] for frame in frames]
    steps = set(np.diff([frame["numbers"][0] for frame in frames]))
    assert steps in ({1}, {3})  # it leaves the illuminators at whatever rate they have
    poses = np.array([frame["poses"] for frame in frames])
    places = np.array([place.translation_mm for place in SCENE.tracker.places[:2]])
    assert np.linalg.norm(poses[..., :3, 3].mean(axis=0) - places, axis=1).max() < BIAS_LIMIT_MM
    assert np.array([frame["errors"] for frame in frames]).max() < 1.0
