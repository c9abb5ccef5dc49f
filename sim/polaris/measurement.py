"""One frame of the unit: every enabled tool and every stray marker, from the noise of single markers.

The noise of a frame is a function of the scene's seed and of the frames since the start of tracking, so
asking again for the same frame, or not asking for others, changes nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ronna_hw.wire.polaris import MAXIMUM_STRAYS, SystemStatus
from sim.polaris.optics import Optics, Sight
from sim.polaris.ports import Port
from sim.polaris.stage import Stage
from sim.polaris.tracking_rules import Tracked, track
from sim.polaris.volume import Volume
from sim.theatre.faults import FaultBoard
from sim.theatre.noise import noise
from sim.theatre.world import World

Vectors = NDArray[np.float64]

DEVICE = "tracker"
TOOL_LANE, STRAY_LANE, FRAME_LANE, ORDER_LANE = range(4)  # independent noise within one frame
WITHHELD = SystemStatus.DIAGNOSTICS_PENDING | SystemStatus.TEMPERATURE | SystemStatus.HARDWARE_FAILURE
_NOTHING = np.empty((0, 3))


@dataclass(frozen=True)
class Stray:
    """A marker that belongs to no tool."""

    position_mm: tuple[float, float, float]
    inside: bool


@dataclass(frozen=True)
class Frame:
    """All that one reply can tell. `tools` pairs each enabled port's handle with what was found."""

    number: int
    tools: tuple[tuple[Port, Tracked | None], ...]  # None: this handle has nothing that could be seen
    strays: tuple[Stray, ...]
    system_status: SystemStatus


class Measurer:
    """Measures the scene of a world. Keeps what stands still from frame to frame."""

    def __init__(self, world: World) -> None:
        self._seed = world.scene.seed
        self._stage = Stage(world)
        self._optics = Optics(world.scene.tracker, self._seed)
        self._faults = FaultBoard(world, DEVICE)
        self._fixed = np.vstack([self._stage.fiducials_mm, self._stage.strays_mm])
        self._fixed_sight = self._optics.sight(self._fixed)
        self._sights: dict[int, tuple[bytes, Sight]] = {}

    def hangs_on_mount(self, port: Port) -> bool:
        """True when the tool of this port is the reference frame M on the mount."""
        return port.definition is not None and self._stage.hangs_on_mount(port.definition)

    def forget_tools(self) -> None:
        """Tools were loaded, freed or enabled: nothing kept about them holds."""
        self._sights.clear()

    def frame(
        self, number: int, since_start: int, ports: tuple[Port, ...], volume: Volume, status: SystemStatus
    ) -> Frame:
        """Measure frame `number`, the `since_start`-th since tracking began."""
        if status & WITHHELD:
            return Frame(number, tuple((port, None) for port in ports), (), status)
        hidden = tuple(fault.argument for fault in self._faults.active("occlude_tool"))
        generator = noise(self._seed, DEVICE, since_start, TOOL_LANE)
        tools: list[tuple[Port, Tracked | None]] = []
        frame_found = False
        for port in ports:
            tracked = self._tool(port, generator, hidden, volume)
            tools.append((port, tracked))
            if tracked is not None and tracked.pose is not None and self._is_frame(port):
                frame_found = True
        # Only enabled passive handles make the illuminators fire.
        strays = self._strays(since_start, frame_found, hidden, volume) if ports else ()
        return Frame(number, tuple(tools), strays, status)

    def _is_frame(self, port: Port) -> bool:
        return (
            port.definition is not None
            and port.definition.part_number == self._stage.frame_on_mount.part_number
        )

    def _tool(
        self, port: Port, generator: np.random.Generator, hidden: tuple[str, ...], volume: Volume
    ) -> Tracked | None:
        definition = port.definition
        if definition is None:
            return None
        pose = self._stage.pose(definition, port.place)
        if pose is None:
            return track(definition, [], _NOTHING, [])
        sight = self._tool_sight(port.handle, pose, self._stage.markers_mm(definition))
        measured = sight.measured(generator.standard_normal(sight.mean_mm.shape))
        if self._stage.name(definition) in hidden or definition.part_number in hidden:
            return track(definition, [], _NOTHING, [])
        count = min(len(measured), len(definition.markers_mm))
        measured = measured[:count]
        inside = [volume.holds(x, y, z) for x, y, z in measured.tolist()]
        return track(definition, list(range(count)), measured, inside)

    def _tool_sight(self, handle: int, pose: Vectors, markers_mm: Vectors) -> Sight:
        key = pose.tobytes()
        kept = self._sights.get(handle)
        if kept is not None and kept[0] == key:
            return kept[1]
        sight = self._optics.sight(markers_mm @ pose[:3, :3].T + pose[:3, 3])
        self._sights[handle] = (key, sight)
        return sight

    def _strays(
        self, since_start: int, frame_found: bool, hidden: tuple[str, ...], volume: Volume
    ) -> tuple[Stray, ...]:
        generator = noise(self._seed, DEVICE, since_start, STRAY_LANE)
        measured = self._fixed_sight.measured(generator.standard_normal(self._fixed.shape))
        covered = [fault.argument for fault in self._faults.active("occlude_marker")]
        if covered:
            numbers = self._stage.fiducial_numbers
            seen = [k for k in range(len(measured)) if k >= len(numbers) or str(numbers[k]) not in covered]
            measured = measured[seen]
        if not frame_found:
            measured = np.vstack([measured, self._frame_as_strays(since_start, hidden)])
        points = measured[:MAXIMUM_STRAYS].tolist()
        # The order carries no identity: it changes with every frame.
        order = noise(self._seed, DEVICE, since_start, ORDER_LANE).permutation(len(points))
        return tuple(Stray((x, y, z), volume.holds(x, y, z)) for x, y, z in (points[k] for k in order))

    def _frame_as_strays(self, since_start: int, hidden: tuple[str, ...]) -> Vectors:
        """The spheres of the frame on the mount are there whether or not anybody tracks it."""
        pose = self._stage.mount_pose()
        if pose is None or self._stage.frame_on_mount.name in hidden:
            return _NOTHING
        sight = self._optics.sight(self._stage.frame_markers_mm @ pose[:3, :3].T + pose[:3, 3])
        generator = noise(self._seed, DEVICE, since_start, FRAME_LANE)
        return sight.measured(generator.standard_normal(sight.mean_mm.shape))
