"""Theatre launcher: starts one process per device in one world, then writes the theatre file.

The devices are forked: what they need of NumPy, models and the world is imported already.
"""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any
from uuid import uuid4

from ronna_hw.bounded_input import InputRefused, read_toml
from ronna_hw.host.child_process import IDLE_TIMEOUT_S, READY_TIMEOUT_S, ChildProcess
from ronna_hw.host.forked_process import ForkedProcess
from ronna_hw.host.process import describe_exit
from ronna_hw.records import write_atomically
from sim.errors import BAD_CALIBRATION_FILE, BAD_DEVICE_PARAMETER, BAD_SAVED_WORLD
from sim.kuka.pendant import PENDANT_PREFIX
from sim.polaris.unit.behaviour import UnitBehaviour
from sim.polaris.unit.tool_definition import write_definition
from sim.theatre.arm_controllers import controller_of, device_name
from sim.theatre.theatre_file import NO_RECORDS, theatre_content, write_theatre_file
from sim.world.control_port import ControlledRoom, ControlPort
from sim.world.options import OTHER_ARMS, ArmRole
from sim.world.saved_world import SavedWorld, save_world
from sim.world.scene.model import Scene
from sim.world.scene.skin import prepare_skin
from sim.world.truth import SCENE_FILE
from sim.world.world import World

THEATRE_FILE = "theatre.toml"
# Shorter than the caller's limits for the theatre: it must learn which device does not start.
DEVICES_READY_LIMIT_S = READY_TIMEOUT_S - 2.0  # in all
DEVICE_IDLE_LIMIT_S = IDLE_TIMEOUT_S - 2.0
STOP_LIMIT_S = 0.5  # for a device that does not become ready: it has nothing to save yet
CLOSE_LIMIT_S = 1.0  # for all devices; one that hangs is then killed, before this process must exit
REST_LIMIT_S = 0.3  # host time
REST_LOOK_S = 0.005
SILENCE_LIMIT_PACED_S = 0.25
# In lock-step the controller waits up to 2 s for a reply, so the silence limit must be higher.
SILENCE_LIMIT_LOCK_STEP_S = 5.0
# A program on a busy computer waits for a processor; no more theatre time passes than it has allowed.
HEARTBEAT_LIMIT_LOCK_STEP_S = 30.0
NO_PARAMETERS: Mapping[str, Sequence[str]] = {}

CALIBRATION_FILE = "calibration.toml"

ROBOT, TRACKER = "robot", "tracker"  # devices by their names in fault scripts
POLARIS = "polaris"
PLUS_ENDPOINT = "igtl://127.0.0.1:0"  # of a tracker behind a server such as PLUS


def _find_teller(world: World) -> Callable[[], dict[str, Any]]:
    from sim.theatre.true_room import TrueRoom  # not for the theatre of a run

    return TrueRoom(world).tell


class LaunchedTheatre:
    """A running theatre: world, control port and a process per device."""

    def __init__(
        self,
        scene: Scene,
        folder: Path,
        *,
        paced: bool,
        tracker_endpoint: str | None = None,
        cycle_ms: int | None = None,
        faults: str = "",
        parameters: Mapping[str, Sequence[str]] = NO_PARAMETERS,
        saved: SavedWorld | None = None,
        records: Mapping[str, Any] = NO_RECORDS,
        on_forked: Callable[[], None] = lambda: None,
        tells_truth: bool = False,
    ) -> None:
        """Start the theatre, keeping the robot context's cycle if `cycle_ms` is None.

        The tracker is reached as its model is, unless `tracker_endpoint` says otherwise. `parameters` are
        NAME=VALUE by device; `saved` is the world of an earlier theatre, to continue from; `records` replace
        the theatre's own calibrations. No thread may run before `on_forked` is called. Raises PRC-001 when a
        device does not become ready, SIM-012 if the earlier theatre's file is lost.
        """
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self.file = folder / THEATRE_FILE
        self.world = World.create(scene, paced=paced) if saved is None else saved.restore(scene, paced=paced)
        if faults:
            _, standing_script = self.world.fault_script()
            self.world.set_fault_script(f"{standing_script}\n{faults}" if standing_script else faults)
        write_atomically(folder / SCENE_FILE, scene.model_dump_json(by_alias=True, indent=1).encode())
        identity, calibrated = (uuid4().hex, None) if saved is None else _read_origin(self.file)
        self._forked: dict[str, ForkedProcess] = {}
        self._children: list[ChildProcess] = []
        self._control: ControlPort | None = None
        if scene.projector is not None:
            prepare_skin(scene.head)  # once, for all of the forks
        try:
            self._fork_devices(parameters, cycle_ms, tracker_endpoint)
            on_forked()
            self._children = [
                ChildProcess(
                    f"ronna-sim {name}",
                    device.args,
                    timeout_s=None,
                    started=device,
                    on_message=_pass_on_pendant,
                )
                for name, device in self._forked.items()
            ]
            truth = _find_teller(self.world) if tells_truth else None
            self._control = ControlPort(ControlledRoom(self.world, folder, identity=identity, truth=truth))
            self.endpoints = self._await_devices(self._forked)
            limit_s = SILENCE_LIMIT_PACED_S if paced else SILENCE_LIMIT_LOCK_STEP_S
            content = theatre_content(
                scene,
                self.endpoints,
                self.world.clock_endpoint,
                self._write_tools(),
                limit_s,
                cycle_ms=cycle_ms,
                calibrated=calibrated,
                parameters=parameters.get(device_name(scene, ArmRole.MASTER), ()),
                records=records,
            )
            if not paced:
                for robot in content["robot"].values():
                    robot["options"]["heartbeat_limit_s"] = HEARTBEAT_LIMIT_LOCK_STEP_S
            save_world(self.world, folder)  # from here on it can be continued, also if it is killed
            told = {"tells_truth": True} if tells_truth else {}
            write_theatre_file({"identity": identity, **told, **content}, self.file)
        except BaseException:  # including interruptions: no device process is left behind
            self.close()
            raise

    @property
    def control(self) -> str:
        """Control port endpoint."""
        assert self._control is not None, "the theatre is open"
        return self._control.endpoint

    def watch(self, on_end: Callable[[str], None]) -> None:
        """Call `on_end` with the reason if a device process ends unprompted."""

        def wait(child: ChildProcess) -> None:
            code = child.process.wait()
            words = " / ".join(child.messages) or describe_exit(code)
            on_end(f"{child.name} ended: {words}")

        for child in self._children:
            threading.Thread(target=wait, args=(child,), daemon=True).start()

    def close(self) -> None:
        """Save the world's state, then stop all device processes and the control port."""
        self._save_world()
        for device in self._forked.values():
            device.terminate()  # all at once, then wait for each
        deadline = time.monotonic() + CLOSE_LIMIT_S
        for child in self._children:
            child.stop(max(0.0, deadline - time.monotonic()))
        if self._control is not None:
            self._control.close()

    def _save_world(self) -> None:
        """Save the world, first allowing moving arms time to come to rest."""
        limit_s = time.monotonic() + REST_LIMIT_S
        alive = bool(self._children) and all(child.alive for child in self._children)
        roles = [role for role in ArmRole if self.world.has_arm(role)]
        while (
            alive and not all(self.world.arm(role).at_rest for role in roles) and time.monotonic() < limit_s
        ):
            time.sleep(REST_LOOK_S)
        with contextlib.suppress(OSError):  # a full disk must not keep the devices from ending
            save_world(self.world, self.folder)

    def _fork_devices(
        self, parameters: Mapping[str, Sequence[str]], cycle_ms: int | None, tracker_endpoint: str | None
    ) -> None:
        world = ("--world", self.world.endpoint)
        scene = self.world.scene

        def robot(role: ArmRole) -> tuple[str, ...]:
            arm = scene.arm_of(role)
            controller = controller_of(arm)
            return (controller.device, *world, *controller.arguments(arm.variant, role, cycle_ms))

        commands: dict[str, tuple[str, ...]] = {
            "polaris": (
                "polaris",
                *world,
                *(() if tracker_endpoint is None else ("--endpoint", tracker_endpoint)),
            ),
            device_name(scene, ArmRole.MASTER): robot(ArmRole.MASTER),
            "basler": ("basler", *world),
        }
        commands |= {device_name(scene, role): robot(role) for role in OTHER_ARMS if role in scene.arms}
        for name, more in commands.items():
            settings = (f"--set={one}" for one in parameters.get(name, ()))
            self._forked[name] = ForkedProcess("sim.cli", *more, *settings)

    def _await_devices(self, names: Iterable[str]) -> dict[str, Any]:
        """Wait until all devices are ready; return their endpoints by name."""
        endpoints: dict[str, Any] = {}
        began = time.monotonic()
        for name, child in zip(names, self._children, strict=True):
            ready = child.await_ready(DEVICES_READY_LIMIT_S, STOP_LIMIT_S, began, DEVICE_IDLE_LIMIT_S)
            endpoints[name] = ready["endpoint"] if "endpoint" in ready else ready["endpoints"]
        return endpoints

    def _write_tools(self) -> dict[str, str]:
        files = {}
        for tool in self.world.scene.tracker.tools:
            path = self.folder / f"{tool.name}.rom"
            write_atomically(path, write_definition(tool))
            files[tool.name] = path.name  # beside the theatre file: a run may be moved
        return files


def _read_origin(theatre_file: Path) -> tuple[str, datetime]:
    """Read identity and calibration time of the theatre to continue; raises SIM-012."""
    try:
        content = read_toml(theatre_file, InputRefused)
        return content["identity"], content["calibration"]["stereo_head"]["created"]
    except (OSError, ValueError, KeyError):
        raise BAD_SAVED_WORLD(
            f"{theatre_file} does not say which theatre it was",
            expected="its identity and the time of its calibration records",
        ) from None


def _pass_on_pendant(line: str) -> None:
    if line.startswith(PENDANT_PREFIX):
        sys.stderr.write(f"{line}\n")
        sys.stderr.flush()


def read_calibrations(paths: Iterable[Path]) -> dict[str, Any]:
    """Read calibration records by name, with later files taking precedence; raises SIM-014.

    Readers of the theatre file check their content.
    """
    records: dict[str, Any] = {}
    for path in paths:
        file = path / CALIBRATION_FILE if path.is_dir() else path
        try:
            found = read_toml(file, BAD_CALIBRATION_FILE).get("calibration")
        except OSError as error:
            raise BAD_CALIBRATION_FILE(f"cannot read {file}: {error.strerror}") from error
        if not isinstance(found, dict) or not found:
            raise BAD_CALIBRATION_FILE(f"{file} has no table [calibration] with records")
        records |= found
    return records


def parameters_by_device(settings: Sequence[str], scene: Scene) -> dict[str, tuple[str, ...]]:
    """Group `DEVICE.NAME=VALUE` settings, such as `robot.lag_s=0.03`, by the device's name in the READY line.

    `robot` is the master. Raises SIM-010 for a device without parameters, PSU-001 or the error of the arm's
    controller for an unknown parameter.
    """
    arms = scene.arms
    names = {TRACKER: POLARIS, **{_option_name(role): device_name(scene, role) for role in arms}}
    found: dict[str, tuple[str, ...]] = {}
    for setting in settings:
        device, dot, assignment = setting.partition(".")
        if device not in names or not dot or "=" not in assignment:
            raise BAD_DEVICE_PARAMETER(
                f"{setting!r} is not DEVICE.NAME=VALUE",
                expected=" or ".join(f"{name}.NAME=VALUE" for name in names),
            )
        name = names[device]
        found[name] = (*found.get(name, ()), assignment)
    for role, arm in arms.items():
        controller_of(arm).parameters.parse(found.get(device_name(scene, role), ()))
    UnitBehaviour.parse(found.get(POLARIS, ()))
    return found


def _option_name(role: ArmRole) -> str:
    return ROBOT if role is ArmRole.MASTER else role.value
