"""The tracker's driver beside ndicapi and scikit-surgerynditracker, all on `ronna-sim polaris`, one tool, BX.

Each client has a simulator of its own, because a unit serves one host at a time; they wait while another
one's turn it is. ndicapi is C and parses in well under a microsecond: its rate is the simulator's.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from contextlib import ExitStack, redirect_stdout, suppress
from functools import partial
from io import StringIO
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.contest import contest, process_cpu_s, rate_of
from benchmarks.figures import Figure, compared
from drivers.ndi_polaris import PolarisTracker
from drivers.ndi_polaris.tracking import FRAME_OPTIONS
from ronna_hw.child_process import ChildProcess, command
from ronna_hw.clock import open_clock
from ronna_hw.config import DeviceConfig
from sim.polaris.definition import write_definition
from sim.theatre.built_in import robot_frame
from sim.theatre.process import load_scene
from sim.theatre.world import World

ROUNDS = 10
BLOCK_S = 0.12
TOOL = "robot_frame"
PTY, TCP = "serial-pty", "tcp://127.0.0.1:0"
OURS, NDICAPI, SCIKIT = "driver", "ndicapi", "scikit-surgerynditracker"
BX = f"BX:{FRAME_OPTIONS.value:04X}"  # for ndicapi the very request of the driver
PORT_REQUEST = "PHRQ:*********1****"
PARSED_ALTHOUGH = UnicodeDecodeError  # ndicapi turns binary replies into text after it has parsed them

Reader = Callable[[], object]


def measure() -> list[Figure]:
    """Readings per second as fast as each client can ask, then with a new frame for each request."""
    with tempfile.TemporaryDirectory() as folder:
        rom = Path(folder) / f"{TOOL}.rom"
        rom.write_bytes(write_definition(robot_frame()))
        return [
            *_race("TCP", TCP, rom, (OURS, NDICAPI, SCIKIT)),
            *_race("pty", PTY, rom, (OURS, NDICAPI, SCIKIT)),
            *_race("TCP, each frame new", TCP, rom, (OURS, NDICAPI), paced=False),
        ]


def _race(
    where: str, endpoint: str, rom: Path, clients: tuple[str, ...], *, paced: bool = True
) -> list[Figure]:
    makers: dict[str, Callable[[ExitStack, str, Path], Reader]] = {
        OURS: _driver,
        NDICAPI: _ndicapi,
        SCIKIT: _scikit,
    }
    with ExitStack() as stack:
        readers: dict[str, Reader] = {}
        pids: dict[str, int] = {}
        for name in clients:
            world = World.create(load_scene("bench"), paced=paced)
            arguments = command("sim.cli", "polaris", "--endpoint", endpoint, "--world", world.endpoint)
            unit = stack.enter_context(ChildProcess(f"ronna-sim polaris for {name}", arguments))
            readers[name] = makers[name](stack, unit.ready["endpoint"], rom)
            pids[name] = unit.process.pid
        client_cpu: dict[str, list[float]] = {name: [] for name in clients}
        unit_cpu = dict.fromkeys(clients, 0.0)
        replies = dict.fromkeys(clients, 0.0)

        def block(name: str) -> float:
            before_s = process_cpu_s(pids[name])
            rate, cpu_s = rate_of(readers[name], BLOCK_S)
            client_cpu[name].append(cpu_s)
            unit_cpu[name] += process_cpu_s(pids[name]) - before_s
            replies[name] += rate * BLOCK_S
            return rate

        samples = contest({name: partial(block, name) for name in clients}, ROUNDS)
        figures = compared(f"readings per second, {where}", "1/s", samples, NDICAPI)
        figures += compared(f"CPU per reading, client, {where}", "µs", client_cpu, NDICAPI, scale=1e6)
        cpu_s = median(unit_cpu[name] / replies[name] for name in clients)
        return [*figures, Figure(f"CPU per reply, {where}", "ronna-sim polaris", cpu_s * 1e6, "µs")]


def _driver(stack: ExitStack, endpoint: str, rom: Path) -> Reader:
    config = DeviceConfig(
        driver="ndi_polaris",
        endpoint=endpoint,
        options={"tools": [{"name": TOOL, "rom": str(rom)}], "reply": "BX"},
    )
    tracker = PolarisTracker("tracker", config, open_clock("host:"))
    stack.callback(tracker.close)
    tracker.connect()
    tracker.configure()
    tracker.activate()

    def read() -> None:
        if tracker.read_frame().tool(TOOL).position_mm is None:
            raise RuntimeError("the driver does not see the tool")

    return read


def _ndicapi(stack: ExitStack, endpoint: str, rom: Path) -> Reader:
    import ndicapy  # type: ignore[import-not-found]

    if endpoint.startswith("serial://"):
        path = endpoint.removeprefix("serial://")
        ndicapy.ndiProbe(path)
        device = ndicapy.ndiOpen(path)
        stack.callback(ndicapy.ndiClose, device)
    else:
        device = ndicapy.ndiOpenNetwork("127.0.0.1", int(endpoint.rsplit(":", 1)[1]))
        stack.callback(ndicapy.ndiCloseNetwork, device)
    ndicapy.ndiCommand(device, "INIT:")
    ndicapy.ndiCommand(device, PORT_REQUEST)
    port = ndicapy.ndiGetPHRQHandle(device)
    ndicapy.ndiPVWRFromFile(device, port, str(rom))
    for setup in (f"PINIT:{port:02X}", f"PENA:{port:02X}D", "TSTART:80"):
        ndicapy.ndiCommand(device, setup)
    handle = bytes([port])

    def read() -> None:
        with suppress(PARSED_ALTHOUGH):
            ndicapy.ndiCommand(device, BX)
        if not isinstance(ndicapy.ndiGetBXTransform(device, handle), tuple):
            raise RuntimeError("ndicapi does not see the tool")

    return read


def _scikit(stack: ExitStack, endpoint: str, rom: Path) -> Reader:
    import ndicapy
    from sksurgerynditracker import nditracker  # type: ignore[import-untyped]

    wanted: dict[str, Any] = {"romfiles": [str(rom)]}
    if endpoint.startswith("serial://"):
        wanted |= {"tracker type": "polaris", "serial port": endpoint.removeprefix("serial://")}
    else:
        wanted |= {"tracker type": "vega", "ip address": "127.0.0.1", "port": int(endpoint.rsplit(":", 1)[1])}
        nditracker.call = lambda _arguments: 0  # it runs the program ping first, which need not exist
    with redirect_stdout(StringIO()):
        tracker = nditracker.NDITracker(wanted)
    # It chooses TX or BX by the firmware's name; here everybody reads BX.
    tracker._get_frame, tracker._get_transform = ndicapy.ndiGetBXFrame, ndicapy.ndiGetBXTransform
    tracker._capture_string = "BX:0801"
    tracker.start_tracking()
    stack.callback(tracker.close)

    def read() -> None:
        _, _, _, poses, _ = tracker.get_frame()
        if not poses[0][3, 3] == 1.0:
            raise RuntimeError("scikit-surgerynditracker does not see the tool")

    return read
