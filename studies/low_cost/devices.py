"""The room's tracker, a simulated Vicra read by its driver over the wire, its looks, and a person's hand."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import cast

from procedures.workcell.patient_frame import as_patient
from procedures.workcell.tracker_look import mean_pose
from ronna_hw import patient_frame
from ronna_hw.clock import open_clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.sensors import OpticalTracker, new_frames
from ronna_hw.frames import Transform
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.registry import make_device
from sim.world.rigid import Matrix, inverse, matrix_of
from sim.world.scene.model import Scene
from sim.world.world import ArmState, World
from studies.errors import TRACKER_NOT_SIMULATED

TOOL_FRAME, PHANTOM_FRAME = "robot_frame", patient_frame.NAME  # definitions shipped with the driver
VICRA_HZ = 20
NO_TOOL = 0  # the pointer is no tool of the theatre's: it hides nothing
# Host time, as safeguards: in lock-step a busy computer only makes a frame late.
START_LIMIT_S, FRAME_LIMIT_S = 60.0, 30.0
LEAST_SHARE = 0.5  # of the frames that must show a tool


class Hand:
    """A person who holds the tool in view of the tracker, without an arm."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._from_tool = inverse(matrix_of(world.scene.mount.flange_from_tool_true))
        self._moved = 0

    def hold(self, robot_from_tip: Matrix) -> None:
        """Hold the tool still at a true pose (4, 4) of its tip."""
        self._moved += 1
        self._world.publish_arm(ArmState((0.0,) * 6, robot_from_tip @ self._from_tool, self._moved, True))


@contextmanager
def open_room(scene: Scene) -> Iterator[tuple[World, OpticalTracker]]:
    """Start a simulated Vicra in a world of its own, in lock-step, and track both frames. Raises PRC-001."""
    world = World.create(scene, paced=False)
    world.mount_tool(NO_TOOL)
    arguments = command("sim.cli", "polaris", "--endpoint", "tcp://127.0.0.1:0", "--world", world.endpoint)
    with ExitStack() as stack:
        unit = stack.enter_context(ChildProcess("ronna-sim polaris", arguments))
        config = DeviceConfig(
            driver="ndi_polaris",
            endpoint=unit.ready["endpoint"],
            options={
                "tools": [{"name": name, "rom": f"{name}.rom"} for name in (TOOL_FRAME, PHANTOM_FRAME)],
                "expected_model": scene.tracker.model,
                "illuminator_rate_hz": VICRA_HZ,
                "time_limits_s": {"BX": FRAME_LIMIT_S},
            },
        )
        clock = open_clock(world.clock_endpoint)
        tracker = cast("OpticalTracker", make_device("tracker", config, clock))
        stack.callback(tracker.close)
        stack.enter_context(tracker.active(START_LIMIT_S))
        yield world, tracker


@dataclass(frozen=True)
class StudiedSight:
    """Mean poses TRACKER <- MARKER of the tool's frame and TRACKER <- PATIENT of the phantom's."""

    tool: Transform
    phantom: Transform

    @property
    def patient_from_marker(self) -> Transform:
        """Pose of the tool's frame in that of the phantom."""
        return self.phantom.inverse() @ self.tool


def look(tracker: OpticalTracker, frames: int) -> StudiedSight | None:
    """Average `frames` measurements, or return None where either frame is hidden."""
    read = list(new_frames(tracker, frames, timeout_s=FRAME_LIMIT_S))
    least = max(1, round(LEAST_SHARE * len(read)))
    tool, phantom = (mean_pose(read, name, least) for name in (TOOL_FRAME, PHANTOM_FRAME))
    return None if tool is None or phantom is None else StudiedSight(tool, as_patient(phantom))


def require_look(tracker: OpticalTracker, frames: int) -> StudiedSight:
    """Average `frames` measurements. Raises STU-008 where either frame is hidden."""
    if (found := look(tracker, frames)) is None:
        raise TRACKER_NOT_SIMULATED("the tracker does not see both frames")
    return found
