"""Simulated devices started for the tests of a program that talks to such devices.

Each is a process with endpoints that nobody else uses. It ends with its fixture, or with the process of the
tests, however that ends.
"""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from ronna_hw.control_port import ask_control_port
from ronna_hw.endpoints import Endpoint, parse_endpoint
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.host.network import own_address
from ronna_hw.near_names import did_you_mean
from ronna_hw.wire.universal_robots import RTDE_PORT
from sim.errors import NO_FREE_ADDRESS, NO_SUCH_SIMULATOR
from sim.world.running import variables_of

FREE = "tcp://127.0.0.1:0"
MOST_ADDRESSES = 3  # that `own_address` has for one process


class Simulator:
    """Running simulated device or theatre. `ready` holds the fields of its READY line."""

    def __init__(self, kind: str, options: Sequence[str]) -> None:
        """Start `ronna-sim KIND OPTIONS`, and wait until clients may connect; raises PRC-001."""
        self.kind = kind
        self._process = ChildProcess(f"ronna-sim {kind}", command("sim.cli", kind, *options))
        self._was_stopped = False
        self.ready: dict[str, Any] = self._process.ready

    def __repr__(self) -> str:
        return f"<Simulator {self.kind}: {self.variables}>"

    @property
    def endpoints(self) -> dict[str, Any]:
        """Endpoints by their role, such as `rtde` or `left`; of a theatre by device and role."""
        single = self.ready.get("endpoint")
        return dict(self.ready["endpoints"]) if single is None else {self.kind: single}

    @property
    def endpoint(self) -> str:
        """The first of the endpoints: the only one of a tracker."""
        return str(next(iter(self.endpoints.values())))

    @property
    def host(self) -> str:
        """Address of the first endpoint."""
        return parse_endpoint(self.endpoint).host

    @property
    def port(self) -> int:
        """Port of the first endpoint; where a KUKA client must listen."""
        return parse_endpoint(self.endpoint).port

    @property
    def path(self) -> str:
        """Path of a tracker's serial line."""
        return self.endpoint.removeprefix("serial://")

    def place(self, role: str) -> tuple[str, int]:
        """Return host and port of the endpoint with this role, as `socket.create_connection` takes them."""
        found: Endpoint = parse_endpoint(self.endpoints[role])
        return found.host, found.port

    @property
    def variables(self) -> dict[str, str]:
        """Environment variables for a program under test: those of `ronna-sim env`."""
        return variables_of(self.ready)

    @property
    def file(self) -> Path:
        """Theatre file, for `open_theatre`."""
        return Path(self.ready["file"])

    @property
    def control(self) -> str:
        """Control port, for `ronna-sim fault` and `mount`."""
        return self.variables["RONNA_CONTROL"]

    def inject(self, line: str) -> str:
        """Inject a fault, such as `tracker hide tool 1 for 2 s`; return its effect.

        It begins now unless the line says when. Raises CTL-002 for a line that is refused.
        """
        return str(ask_control_port(self.control, "fault", line=line)["effect"])

    def clear(self, line: str | None = None) -> None:
        """End the fault with this line, or all faults."""
        ask_control_port(self.control, "clear_faults", **({} if line is None else {"line": line}))

    @property
    def alive(self) -> bool:
        """Whether the simulator runs."""
        return self._process.alive

    def stop(self) -> None:
        """End the simulator, as a device that is switched off; never raises."""
        self._was_stopped = True
        self._process.stop()

    def describe_failure(self) -> str:
        """Describe why the simulator ended by itself; empty if it runs or was stopped."""
        if self.alive or self._was_stopped:
            return ""
        return " / ".join((f"ronna-sim {self.kind} ended during the test", *self._process.messages))


@contextmanager
def running(
    kind: str, options: Sequence[str], scene: str | None, new_folder: Callable[[], Path]
) -> Iterator[Simulator]:
    """Run a simulator for a block, on free endpoints, in a scene unless the options name one.

    `new_folder` makes the folder of a theatre. Raises SIM-020, SIM-021, and PRC-001 with the command's own
    message.
    """
    if kind not in DEFAULTS:
        raise NO_SUCH_SIMULATOR(
            f"there is no simulator {kind!r}",
            expected=", ".join(DEFAULTS),
            action=did_you_mean(kind, [*DEFAULTS]),
        )
    if scene is not None and "--scene" not in options:
        options = ("--scene", scene, *options)
    simulator = Simulator(kind, (*_without(DEFAULTS[kind](new_folder), options), *options))
    try:
        yield simulator
    finally:
        simulator.stop()


def _without(defaults: Sequence[str], options: Sequence[str]) -> Iterator[str]:
    """Yield the defaults, in pairs of option and value, of which the options give no other value."""
    for name, value in zip(defaults[::2], defaults[1::2], strict=True):
        if name not in options:
            yield from (name, value)


def _free_stream() -> str:
    """Return an endpoint where a KUKA client may listen: on this process's own address nobody else does."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind((own_address(), 0))
        host, port = one.getsockname()
    return f"udp://{host}:{port}"


def _free_address() -> str:
    """Return an address at which no UR controller of this process is: their ports are fixed."""
    for address in map(own_address, range(MOST_ADDRESSES)):
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as one, suppress(OSError):
            one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as the controller does
            one.bind((address, RTDE_PORT))
            return address
    raise NO_FREE_ADDRESS(f"{MOST_ADDRESSES} simulated UR controllers of this process run already")


DEFAULTS: Mapping[str, Callable[[Callable[[], Path]], Sequence[str]]] = {
    "polaris": lambda _: ("--endpoint", FREE),
    "kuka": lambda _: ("--rsi", _free_stream(), "--eki", FREE, "--eki-project", FREE),
    "ur": lambda _: ("--address", _free_address()),
    "basler": lambda _: (),  # finds free addresses itself
    "theatre": lambda new_folder: ("--out", str(new_folder()), "--scene", "mini", "--speed", "1"),
}
