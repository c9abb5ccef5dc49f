"""Main entry point: opens all devices of a theatre file for the duration of a block.

    with open_theatre("theatre.toml") as theatre, theatre.tracker.active() as tracker:
        frame = tracker.read_frame()

A whole simulated theatre takes one line, too: it is the command `ronna-sim theatre` for the length of a
block, opened with the file that the command writes. Nothing is imported from the simulators.

    with simulated_theatre("mini", seed=7) as theatre:
        ...
"""

from __future__ import annotations

import os
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Self, TypeVar, cast

from ronna_hw.arguments import require_duration_s, require_path, require_seed
from ronna_hw.clock import Clock, SharedClock, open_clock
from ronna_hw.config import Calibrations, DeviceConfig, TheatreFile, read_theatre_file
from ronna_hw.devices.capabilities import ByteSink, RecordsBytes
from ronna_hw.devices.errors import THEATRE_CLOSED, WRONG_KIND, NotInTheatre
from ronna_hw.devices.lifecycle import RUNNING, Device, Lifecycle
from ronna_hw.devices.robot import RobotArm, StopKind
from ronna_hw.devices.sensors import OpticalTracker, StereoPair
from ronna_hw.errors import summary_of
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.host.process import defer_interruption
from ronna_hw.logs import logger
from ronna_hw.opened_by_with import opened_by_with
from ronna_hw.registry import make_device

if TYPE_CHECKING:
    from ronna_hw.simulated_room import SimulatedRoom

D = TypeVar("D")
DriverOfTable = Callable[[str, DeviceConfig, Clock], Device]
STOP_LIMIT_S = 5.0  # host time, for all arms together


@opened_by_with
def open_theatre(path: str | os.PathLike[str], timeout_s: float = 10.0) -> Iterator[Theatre]:
    """Connect and configure all devices of a theatre file for the duration of a block.

    On leaving, including by an exception or Ctrl-C, the arms are stopped and everything is closed in bounded
    time. Raises ARG-001 for no path or no duration, CFG-001 for a missing or invalid file, and the driver's
    error if a device is not there.
    """
    with Theatre.from_file(path) as theatre:
        theatre.connect(timeout_s)
        yield theatre


class Theatre:
    """Devices of one theatre file. Each is created on first access; `connect` creates all.

    As a context manager it closes everything on leaving.
    """

    def __init__(self, file: TheatreFile, clock: Clock, make: DriverOfTable = make_device) -> None:
        """Create the theatre without opening anything; `make` creates the driver objects."""
        self.file = file
        self._clock = clock
        self._make = make
        self.arms: Mapping[str, RobotArm] = _Arms(self)
        self._devices: dict[str, Device] = {}
        self._checked: dict[tuple[str, object], Device] = {}  # by interface; a driver is checked once
        self._byte_sink: ByteSink | None = None
        self._closed = False

    @classmethod
    def from_file(cls, path: str | os.PathLike[str], make: DriverOfTable = make_device) -> Self:
        """Read the file and open its clock, but no devices. Raises ARG-001, CFG-001 or CLK-001."""
        file = read_theatre_file(require_path(path, "the theatre file"))
        return cls(file, open_clock(file.clock.endpoint), make)

    @property
    def clock(self) -> Clock:
        """Theatre clock; raises DEV-010 once the theatre is closed."""
        self._require_open()
        return self._clock

    @property
    def tracker(self) -> OpticalTracker:
        """Optical tracker; raises DEV-007 if the file has none."""
        return self._get_device_as("tracker", OpticalTracker)

    @property
    def stereo(self) -> StereoPair:
        """Stereo head; raises DEV-007 if the file has none."""
        return self._get_device_as("stereo", StereoPair)

    @property
    def calibrations(self) -> Calibrations:
        """Calibration records; raises DEV-007 if the file has none."""
        if self.file.calibration is None:
            raise NotInTheatre(
                f"theatre {self.file.theatre} has no calibration records",
                action="Add [calibration] to the theatre file.",
            )
        return self.file.calibration

    @property
    def devices(self) -> dict[str, Device]:
        """All devices by table name, such as `robot.master`."""
        return {name: self._get_device(name) for name in self.file.devices}

    def device(self, name: str, interface: Callable[..., D]) -> D:
        """Return the device of table `[device.NAME]` as `interface`: a runtime-checkable protocol or a class.

        Raises DEV-007 if the file has no such table, DEV-008 if the device is of another kind.
        """
        return self._get_device_as(f"device.{name}", interface)

    def require(self, *names: str) -> None:
        """Raise DEV-007 listing any of the given tables, such as `robot.master`, that the file lacks."""
        known = self.file.devices
        if missing := [name for name in names if name not in known]:
            raise NotInTheatre(
                f"theatre {self.file.theatre} has no {', '.join(missing)}",
                got=f"it has {', '.join(known) or 'no devices'}",
            )

    def record_bytes(self, sink: ByteSink) -> None:
        """Record the traffic of all links whose drivers support it. Call before connecting anything."""
        self._byte_sink = sink
        for device in self._devices.values():
            _record_bytes(device, sink)

    def connect(self, timeout_s: float = 10.0) -> None:
        """Connect and configure every device not yet configured, with `timeout_s` per call.

        Raises ARG-001 for no duration, and the driver's error of the first that fails; earlier ones stay
        connected.
        """
        require_duration_s(timeout_s, "timeout_s of the devices")
        for name in self.file.devices:
            device = self._get_device(name)
            if device.state is Lifecycle.DISCONNECTED:
                device.connect(timeout_s)
            if device.state is Lifecycle.CONNECTED:
                device.configure(timeout_s)

    def stop(self) -> list[str]:
        """Stop all arms simultaneously, as far as their links allow; never raises.

        Returns what went wrong, for each arm that may not be at rest.
        """
        failures: list[str] = []
        moving = [  # also one that is being started; in HOLD an earlier stop may still be under way
            threading.Thread(target=_stop_arm, args=(device, failures))
            for device in self._devices.values()
            if isinstance(device, RobotArm) and device.observe().state in (Lifecycle.CONFIGURED, *RUNNING)
        ]
        for stop in moving:
            stop.start()
        for stop in moving:
            stop.join()
        return failures

    def close(self) -> None:
        """Stop the arms, then close all connections, starting with the arms. Bounded in time; never raises.

        An interruption in the meantime takes effect afterwards.
        """
        with defer_interruption():
            self.stop()
            for device in sorted(self._devices.values(), key=lambda one: not isinstance(one, RobotArm)):
                try:
                    device.close()
                except Exception as error:  # the others must be closed nevertheless
                    logger(device=device.name).error("cannot be closed", cause=error)
            if isinstance(self._clock, SharedClock):
                self._clock.close()
            self._closed = True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self.close()
        except KeyboardInterrupt:
            if not self._closed:  # it came before `close` could hold it back
                self.close()
            raise

    def __repr__(self) -> str:
        states = (
            f"{name} {self._devices[name].observe().state if name in self._devices else 'not opened'}"
            for name in self.file.devices
        )
        shown = "closed" if self._closed else ", ".join(states) or "no devices"
        return f"<{type(self).__name__} {self.file.theatre}: {shown}>"

    def _require_open(self) -> None:
        if self._closed:
            raise THEATRE_CLOSED(f"theatre {self.file.theatre} is closed")

    def _get_device_as(self, name: str, interface: Callable[..., D]) -> D:
        device = self._get_device(name)
        if self._checked.get((name, interface)) is device:
            return cast("D", device)
        fitting = require_interface(name, self.file.devices[name].driver, device, interface)
        self._checked[name, interface] = device
        return fitting

    def _get_device(self, name: str) -> Device:
        self._require_open()
        if name not in self._devices:
            self.require(name)
            device = self._make(name, self.file.devices[name], self.clock)
            _record_bytes(device, self._byte_sink)
            self._devices[name] = device
        return self._devices[name]


class _Arms(Mapping[str, RobotArm]):
    """Arms by name. A missing name raises DEV-007."""

    def __init__(self, theatre: Theatre) -> None:
        self._theatre = theatre

    def __getitem__(self, name: str) -> RobotArm:
        return self._theatre._get_device_as(f"robot.{name}", RobotArm)

    def __iter__(self) -> Iterator[str]:
        return iter(self._theatre.file.robot)

    def __len__(self) -> int:
        return len(self._theatre.file.robot)

    def __repr__(self) -> str:
        return f"<arms: {', '.join(self) or 'none'}>"


def _record_bytes(device: Device, sink: ByteSink | None) -> None:
    if isinstance(device, RecordsBytes):
        device.record_bytes(sink)


def _stop_arm(arm: RobotArm, failures: list[str]) -> None:
    try:
        arm.stop(StopKind.HOLD, STOP_LIMIT_S)
    except Exception as error:  # `close` continues, and the link stops the arm when it ends
        logger(device=arm.name).error("may not be at rest: the stop failed", cause=error)
        failures.append(f"{arm.name} may not be at rest, the stop failed: {summary_of(error)}")


_INTERFACES: dict[str, Callable[..., Device]] = {
    "tracker": OpticalTracker,
    "robot": RobotArm,
    "stereo": StereoPair,
}


def required_interface(table: str) -> Callable[..., Device]:
    """Return the interface for a table such as `robot.master`; any device is allowed for `[device.NAME]`."""
    return _INTERFACES.get(table.partition(".")[0], Device)


def require_interface(table: str, driver: str, device: object, interface: Callable[..., D]) -> D:
    """Return a table's device as `interface`, a runtime-checkable protocol or a class.

    Raises DEV-008 naming what the driver lacks.
    """
    if not isinstance(device, cast("type", interface)):
        missing = [name for name in dir(interface) if name[0] != "_" and not hasattr(device, name)]
        raise WRONG_KIND(
            f"{table}: driver {driver} does not provide {interface.__name__}",
            got=f"it lacks {', '.join(missing)}" if missing else None,
        )
    return cast("D", device)


SIMULATOR_NAME = "ronna-sim theatre"
CONTROLLER_SAYS = "pendant at "  # prefix of a message on the simulated controller's pendant


@opened_by_with
def simulated_theatre(
    scene: str | os.PathLike[str] = "mini", *, seed: int = 0, timeout_s: float = 10.0
) -> Iterator[SimulatedTheatre]:
    """Run a simulated theatre for a block, with its devices connected and configured.

    `scene` is `default`, `mini`, `bench` or the path of a scene file. Raises ARG-001 for an argument of
    another type or out of its range, PRC-001 with the command's own message when there is no such scene, and
    the errors of `open_theatre`.
    """
    scene = str(require_path(scene, "the scene"))
    require_seed(seed)
    require_duration_s(timeout_s, "timeout_s of the devices")
    with tempfile.TemporaryDirectory(prefix="ronna-theatre-") as folder:
        process = TheatreProcess("--scene", scene, "--seed", str(seed), "--out", folder, "--tell-truth")
        try:
            process.await_ready()
            with SimulatedTheatre.of(process) as theatre:
                theatre.connect(timeout_s)
                yield theatre
        finally:
            process.end()


class SimulatedTheatre(Theatre):
    """Theatre of simulated devices."""

    control: str = ""  # endpoint for `ronna-sim mount` and `ronna-sim fault`

    @classmethod
    def of(cls, process: TheatreProcess) -> Self:
        """Open the theatre of a ready process."""
        theatre = cls.from_file(process.file)
        theatre.control = process.control
        return theatre

    @property
    def room(self) -> SimulatedRoom:
        """Hands in the room: move, hide and disturb, and look up the truth."""
        from ronna_hw.simulated_room import SimulatedRoom  # with NumPy, which a theatre does not wait for

        return SimulatedRoom(self.control, self._require_open, lambda: self.tracker.tools)


class TheatreProcess:
    """A `ronna-sim theatre` process: after creating it, call `await_ready`, and finally `end`."""

    def __init__(
        self, *arguments: str, on_controller_message: Callable[[str], None] = lambda _line: None
    ) -> None:
        """Start the process. `on_controller_message` receives messages on the simulated pendant."""

        def on_message(line: str) -> None:
            if line.startswith(CONTROLLER_SAYS):
                on_controller_message(line)

        self.child = ChildProcess(
            SIMULATOR_NAME, command("sim.cli", "theatre", *arguments), timeout_s=None, on_message=on_message
        )

    def await_ready(self) -> None:
        """Wait until every device is ready; raises PRC-001 with the command's message."""
        self.child.await_ready()

    @property
    def file(self) -> Path:
        """Theatre file written by the process."""
        return Path(self.child.ready["file"])

    @property
    def control(self) -> str:
        """Endpoint of the control port."""
        return str(self.child.ready["endpoints"]["control"])

    def end(self) -> None:
        """End the process in bounded time, deferring interruptions until then; never raises."""
        with defer_interruption():
            self.child.stop()
