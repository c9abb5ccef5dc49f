"""One frame: every enabled tool and every stray, measured marker by marker.

The noise of a frame is a function of the scene's seed, the tracking and the frames since it started, so
requesting the same frame again, or skipping others, changes nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ronna_hw.wire.polaris import MAXIMUM_STRAYS, PortStatus, SystemStatus
from sim.polaris.measurement.tracking_rules import INFRARED_COPY, Tracked, track
from sim.polaris.measurement.visible_markers import Group, MarkerVisibility, VisibleMarkers
from sim.polaris.optics.marker_noise import Optics
from sim.polaris.optics.measuring_volume import Volume
from sim.polaris.scene.disturbance import Disturbance, Disturbances
from sim.polaris.scene.extra_strays import reflecting_places, reflections
from sim.polaris.scene.true_scene import TrueScene
from sim.polaris.tools.ports import Port
from sim.world.faults import FaultBoard
from sim.world.noise import noise
from sim.world.room_shift import ShiftedRoom
from sim.world.world import World

Vectors = NDArray[np.float64]

DEVICE = "tracker"
# Independent noise within one frame.
TOOL_LANE, STRAY_LANE, FRAME_LANE, ORDER_LANE, PHANTOM_LANE, REFLECTION_LANE = range(6)
SUNLIGHT_REFLECTIONS = 6  # reflections added by sunlight; an estimate without a source
WITHHELD = SystemStatus.DIAGNOSTICS_PENDING | SystemStatus.TEMPERATURE | SystemStatus.HARDWARE_FAILURE


@dataclass(frozen=True)
class Stray:
    """A marker that belongs to no tool."""

    position_mm: tuple[float, float, float]
    inside: bool


@dataclass(frozen=True)
class Frame:
    """Everything one reply can report. `tools` pairs each enabled port's handle with what was found."""

    number: int
    tools: tuple[tuple[Port, Tracked | None], ...]  # None: nothing visible under this handle
    strays: tuple[Stray, ...]
    system_status: SystemStatus


class Measurer:
    """Measures the scene of a world like a unit with these volumes."""

    def __init__(self, world: World, volumes: tuple[Volume, ...]) -> None:
        truth = world.scene.tracker
        self._seed = world.scene.seed
        self._scene = TrueScene(world)
        optics = Optics(truth, self._seed, volumes)
        self._visibility = MarkerVisibility(
            self._scene, optics, self._seed, volumes[0], truth.line_separation_mm
        )
        self._disturbances = Disturbances(FaultBoard(world, DEVICE), ShiftedRoom(world))
        self._usual_reflections = truth.reflections
        self._first_volume = volumes[0]
        self._faces: dict[int, int] = {}  # by handle: the face tracked in the previous frame
        self._trackings = 0  # how often it has started
        self._noise_key = DEVICE

    def hangs_on_mount(self, port: Port) -> bool:
        """Whether this port's tool is the reference frame M on the mount."""
        return port.definition is not None and self._scene.hangs_on_mount(port.definition)

    def begin_tracking(self) -> None:
        """Tracking starts: every one after the first has its own noise.

        A guard that reads the tracker between the steps of a case therefore changes none of its numbers, and
        does not see the noise of an earlier one again.
        """
        self._trackings += 1
        if self._trackings > 1:
            self._noise_key = f"{DEVICE}, session {self._trackings}"

    def forget_tools(self) -> None:
        """Drop caches: tools were loaded, freed or enabled."""
        self._visibility.forget()
        self._faces.clear()

    @property
    def light(self) -> SystemStatus:
        """Bits of the system status set by ambient light."""
        too_much = self._disturbances.now().sunlight
        return SystemStatus.TOO_MUCH_INFRARED if too_much else SystemStatus(0)

    def frame(
        self, number: int, since_start: int, ports: tuple[Port, ...], volume: Volume, status: SystemStatus
    ) -> Frame:
        """Measure frame `number`, the `since_start`-th since tracking began."""
        if status & WITHHELD:
            return Frame(number, tuple((port, None) for port in ports), (), status)
        disturbance = self._disturbances.now()
        arranged = self._visibility.now(ports, disturbance)
        generator = noise(self._seed, self._noise_key, since_start, TOOL_LANE)
        tools: list[tuple[Port, Tracked | None]] = []
        unclaimed: list[tuple[float, float, float]] = []  # markers of tools that were not found
        for port in ports:
            tracked = self._tool(port, arranged.tools[port.handle], generator, volume)
            tools.append((port, tracked))
            if tracked is not None and tracked.pose is None:
                unclaimed += tracked.measured_mm
        # Only enabled passive handles make the illuminators fire.
        strays = self._strays(since_start, arranged, disturbance, unclaimed, volume) if ports else ()
        return Frame(number, tuple(tools), strays, status)

    def _tool(
        self, port: Port, group: Group | None, generator: np.random.Generator, volume: Volume
    ) -> Tracked | None:
        definition = port.definition
        if definition is None:
            return None
        if group is None:
            return track(definition, [], np.empty((0, 3)), [])
        measured = group.sight.measured(generator.standard_normal(group.sight.mean_mm.shape))
        seen = [row for row in group.seen if row < len(definition.markers_mm)]
        if len(seen) < len(measured):
            measured = measured[seen]
        inside = [volume.holds(x, y, z) for x, y, z in measured.tolist()]
        tracked = track(definition, seen, measured, inside, self._faces.get(port.handle, 0), port.faces)
        self._faces[port.handle] = tracked.face
        if not group.disturbed:
            return tracked
        return replace(
            tracked,
            volume_status=tracked.volume_status | PortStatus.IR_INTERFERENCE,
            information=tracked.information | INFRARED_COPY,
        )

    def _strays(
        self,
        since_start: int,
        arranged: VisibleMarkers,
        disturbance: Disturbance,
        unclaimed: list[tuple[float, float, float]],
        volume: Volume,
    ) -> tuple[Stray, ...]:
        points = self._points(arranged.fixed, since_start, STRAY_LANE) + unclaimed
        if arranged.frame is not None:  # its spheres are in view whether or not the tool is tracked
            points += self._points(arranged.frame, since_start, FRAME_LANE)
        points += self._points(arranged.phantoms, since_start, PHANTOM_LANE)
        glints = self._usual_reflections + disturbance.reflections
        glints += SUNLIGHT_REFLECTIONS if disturbance.sunlight else 0
        if glints:
            places = reflecting_places(self._seed, glints, self._first_volume)
            points += _triples(
                reflections(places, noise(self._seed, self._noise_key, since_start, REFLECTION_LANE))
            )
        points = points[:MAXIMUM_STRAYS]
        # Strays have no identity: their order changes with every frame.
        order = noise(self._seed, self._noise_key, since_start, ORDER_LANE).permutation(len(points)).tolist()
        return tuple(Stray(points[k], volume.holds(*points[k])) for k in order)

    def _points(self, group: Group, since_start: int, lane: int) -> list[tuple[float, float, float]]:
        """One measurement of the visible markers of a group."""
        if not group.seen:
            return []
        generator = noise(self._seed, self._noise_key, since_start, lane)
        return _triples(
            group.sight.measured(generator.standard_normal(group.sight.mean_mm.shape))[group.seen]
        )


def _triples(points_mm: Vectors) -> list[tuple[float, float, float]]:
    return [(x, y, z) for x, y, z in points_mm.tolist()]
