"""Frame measurement, marker by marker, of all enabled tools and strays.

Noise is a function of the scene's seed, the tracking session and the frames since its start, so requesting a
frame again, or skipping others, changes nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np

from ronna_hw.patient_frame import PART_NUMBER as PATIENT_FRAME_PART_NUMBER
from ronna_hw.wire.polaris import MAXIMUM_STRAYS, PortStatus, SystemStatus
from sim.polaris.measurement.line_of_sight import Flags, visible
from sim.polaris.measurement.optics import (
    EYES_MM,
    Optics,
    Sight,
    extra_strays,
    is_in_field,
    phantoms,
    reflecting_places,
    reflections,
)
from sim.polaris.measurement.tracking_rules import INFRARED_COPY, TrackedTool, track
from sim.polaris.measurement.true_scene import Disturbance, Disturbances, TrueScene, TrueTool
from sim.polaris.unit.model import UnitVolume
from sim.polaris.unit.ports import Port
from sim.world.displacements import ShiftedRoom
from sim.world.faults import FaultBoard
from sim.world.noise import ReusedNoise
from sim.world.options import OTHER_ARMS
from sim.world.rigid import Vectors
from sim.world.world import ArmState, World

SUNLIGHT_NOISE = 2.0  # factor on the noise under ambient infrared light; an estimate without a source

DEVICE = "tracker"
# Independent noise within one frame.
TOOL_LANE, STRAY_LANE, FRAME_LANE, ORDER_LANE, PHANTOM_LANE, REFLECTION_LANE = range(6)
WITHHELD = SystemStatus.DIAGNOSTICS_PENDING | SystemStatus.TEMPERATURE | SystemStatus.HARDWARE_FAILURE


@dataclass(frozen=True)
class Stray:
    """A measured marker that belongs to no tool."""

    position_mm: tuple[float, float, float]
    inside: bool


@dataclass(frozen=True)
class MeasuredFrame:
    """Reportable data of one frame, with `tools` pairing each enabled port with its result."""

    number: int
    tools: tuple[tuple[Port, TrackedTool | None], ...]  # None: no result
    strays: tuple[Stray, ...]
    system_status: SystemStatus


class Measurer:
    """Measures a world's scene with a unit's sensors and volumes."""

    def __init__(self, world: World, volumes: tuple[UnitVolume, ...]) -> None:
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
        self._faces: dict[int, int] = {}  # face tracked in the previous frame, by handle
        self._sessions = 0  # starts of tracking
        self._noise = ReusedNoise(self._seed, DEVICE)

    def is_mount_frame(self, port: Port) -> bool:
        """Return whether this port's tool is the reference frame M on the mount."""
        return port.definition is not None and self._scene.is_mount_frame(port.definition)

    def begin_tracking(self) -> None:
        """Start a tracking session with its own noise.

        A guard that reads the tracker between two steps therefore changes no number of the case, and does not
        repeat the noise of an earlier session.
        """
        self._sessions += 1
        if self._sessions > 1:
            self._noise = ReusedNoise(self._seed, f"{DEVICE}, session {self._sessions}")

    def forget_tools(self) -> None:
        """Drop the caches after tools have been loaded, freed or enabled."""
        self._visibility.forget()
        self._faces.clear()

    @property
    def light(self) -> SystemStatus:
        """Ambient-light bits of the system status."""
        too_much = self._disturbances.now().sunlight
        return SystemStatus.TOO_MUCH_INFRARED if too_much else SystemStatus(0)

    def frame(
        self, number: int, since_start: int, ports: tuple[Port, ...], volume: UnitVolume, status: SystemStatus
    ) -> MeasuredFrame:
        """Measure frame `number`, `since_start` frames after tracking began."""
        if status & WITHHELD:
            return MeasuredFrame(number, tuple((port, None) for port in ports), (), status)
        disturbance = self._disturbances.now()
        in_view = self._visibility.now(ports, disturbance)
        generator = self._noise.at(since_start, TOOL_LANE)
        tools: list[tuple[Port, TrackedTool | None]] = []
        unclaimed: list[tuple[float, float, float]] = []  # markers of tools without a pose
        for port in ports:
            tracked = self._measure_tool(port, in_view.tools[port.handle], generator, volume)
            tools.append((port, tracked))
            if tracked is not None and tracked.pose is None:
                unclaimed += tracked.measured_mm
        # Illuminators fire for enabled handles only.
        strays = self._measure_strays(since_start, in_view, disturbance, unclaimed, volume) if ports else ()
        return MeasuredFrame(number, tuple(tools), strays, status)

    def _measure_tool(
        self, port: Port, group: Group | None, generator: np.random.Generator, volume: UnitVolume
    ) -> TrackedTool | None:
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

    def _measure_strays(
        self,
        since_start: int,
        in_view: VisibleMarkers,
        disturbance: Disturbance,
        unclaimed: list[tuple[float, float, float]],
        volume: UnitVolume,
    ) -> tuple[Stray, ...]:
        points = self._measure_points(in_view.fixed, since_start, STRAY_LANE) + unclaimed
        if in_view.frame is not None:  # its spheres are in view even if the tool is not loaded
            points += self._measure_points(in_view.frame, since_start, FRAME_LANE)
        points += self._measure_points(in_view.phantoms, since_start, PHANTOM_LANE)
        if glints := disturbance.count_reflections(self._usual_reflections):
            places = reflecting_places(self._seed, glints, self._first_volume)
            points += _as_triples(reflections(places, self._noise.at(since_start, REFLECTION_LANE)))
        points = points[:MAXIMUM_STRAYS]
        # Strays have no identity: their order differs from frame to frame.
        order = self._noise.at(since_start, ORDER_LANE).permutation(len(points)).tolist()
        return tuple(Stray(points[k], volume.holds(*points[k])) for k in order)

    def _measure_points(self, group: Group, since_start: int, lane: int) -> list[tuple[float, float, float]]:
        """Measure the visible markers of a group once."""
        if not group.seen:
            return []
        generator = self._noise.at(since_start, lane)
        return _as_triples(
            group.sight.measured(generator.standard_normal(group.sight.mean_mm.shape))[group.seen]
        )


def _as_triples(points_mm: Vectors) -> list[tuple[float, float, float]]:
    return [(x, y, z) for x, y, z in points_mm.tolist()]


@dataclass(frozen=True)
class Group:
    """Markers of one tool or kind: mean positions, noise, and rows seen by both sensors."""

    sight: Sight
    seen: list[int]
    disturbed: bool = False  # by infrared light


@dataclass(frozen=True)
class VisibleMarkers:
    """All visible markers, with `tools` by handle and None for a tool that is absent or has no markers."""

    tools: dict[int, Group | None]
    frame: Group | None  # reference frame M, unless loaded under a handle
    fixed: Group
    phantoms: Group


class MarkerVisibility:
    """Marker visibility, cached while nothing moves."""

    def __init__(
        self, scene: TrueScene, optics: Optics, seed: int, volume: UnitVolume, line_mm: float
    ) -> None:
        self._scene = scene
        self._optics = optics
        self._seed = seed
        self._volume = volume
        self._line_separation_mm = line_mm
        self._key: object = None
        self._kept: VisibleMarkers | None = None
        self._fixed: tuple[object, TrueTool, Sight] | None = None  # as last disturbed; the arm moves none

    def forget(self) -> None:
        """Drop the cache when handles change."""
        self._kept = None

    def now(self, ports: tuple[Port, ...], disturbance: Disturbance) -> VisibleMarkers:
        """Return the markers currently visible with the given ports enabled."""
        arm, mounted = self._scene.arm(), self._scene.mounted_tool()
        arms = (arm, *map(self._scene.arm, OTHER_ARMS))
        flanges = (None if one is None else one.robot_from_flange.tobytes() for one in arms)
        key = (*flanges, mounted, disturbance)
        if self._kept is None or key != self._key:
            self._kept = self._compute(ports, disturbance, arm, mounted)
            self._key = key
        return self._kept

    def _compute(
        self, ports: tuple[Port, ...], disturbance: Disturbance, arm: ArmState | None, mounted: int
    ) -> VisibleMarkers:
        scene = self._scene
        tools = {
            port.handle: None
            if port.definition is None
            else scene.tool(port.definition, port.place, arm, disturbance)
            for port in ports
        }
        loaded = {port.definition.part_number for port in ports if port.definition is not None}
        frame_loaded = scene.frame_on_mount.part_number in loaded
        frame = None if arm is None or frame_loaded else scene.frame(arm, disturbance)
        on_head = any(port.definition is not None and scene.is_head_frame(port.definition) for port in ports)
        clamp_loaded = PATIENT_FRAME_PART_NUMBER in loaded
        fixed, fixed_sight = self._list_fixed_spheres(
            disturbance, as_tool=on_head, clamp_as_tool=clamp_loaded
        )

        groups = [fixed, *(tool for tool in (*tools.values(), frame) if tool is not None)]
        points = np.vstack([group.markers_mm for group in groups])
        past_mount = np.repeat(
            [scene.is_on_mount(group) for group in groups], [len(group.markers_mm) for group in groups]
        )
        seen = visible(EYES_MM, points, scene.bodies(arm, mounted, disturbance.room), past_mount)
        ends = list(accumulate(len(group.markers_mm) for group in groups))
        for group, end in zip(groups, ends, strict=True):
            if group.covered:
                first = end - len(group.markers_mm)
                seen[:, [first + row for row in group.covered]] = False
        seen &= is_in_field(points)
        rows = {
            id(group): seen[:, end - len(group.markers_mm) : end]
            for group, end in zip(groups, ends, strict=True)
        }

        def group_of(tool: TrueTool | None) -> Group | None:
            if tool is None:
                return None
            return _make_group(tool, self._optics.sight(tool.markers_mm), rows[id(tool)], disturbance)

        ghosts = phantoms(
            EYES_MM, points, seen, max(self._line_separation_mm, disturbance.line_separation_mm)
        )
        ghost_group = Group(self._optics.sight(ghosts), list(range(len(ghosts))))
        return VisibleMarkers(
            tools={handle: group_of(tool) for handle, tool in tools.items()},
            frame=group_of(frame),
            fixed=_make_group(fixed, fixed_sight, rows[id(fixed)], disturbance),
            phantoms=ghost_group,
        )

    def _list_fixed_spheres(
        self, disturbance: Disturbance, *, as_tool: bool, clamp_as_tool: bool
    ) -> tuple[TrueTool, Sight]:
        """Return the spheres of no tool: strays, plus those of the head and its clamp that form none.

        Fiducials may form one (`as_tool`), and so may the patient's frame (`clamp_as_tool`).
        """
        key = (disturbance, as_tool, clamp_as_tool)
        if self._fixed is None or self._fixed[0] != key:
            spheres = self._find_fixed_spheres(disturbance, as_tool=as_tool)
            clamp = None if clamp_as_tool else self._scene.frame_on_clamp(disturbance)
            if clamp is not None:
                more = tuple(len(spheres.markers_mm) + row for row in clamp.covered)
                spheres = TrueTool(
                    frozenset(),
                    np.vstack([spheres.markers_mm, clamp.markers_mm]),
                    (*spheres.covered, *more),
                )
            self._fixed = (key, spheres, self._optics.sight(spheres.markers_mm))
        return self._fixed[1:]

    def _find_fixed_spheres(self, disturbance: Disturbance, *, as_tool: bool) -> TrueTool:
        scene = self._scene
        drawn = extra_strays(self._seed, disturbance.strays, self._volume)
        more = np.vstack([drawn, scene.extra_spheres_at(disturbance.room)])
        if as_tool:
            return TrueTool(frozenset(), np.vstack([scene.strays_mm, more]), ())
        covered = tuple(
            row for row, number in enumerate(scene.fiducial_numbers) if number in disturbance.hidden_fiducials
        )
        return TrueTool(
            frozenset(), np.vstack([scene.expose_fiducials(disturbance.room), scene.strays_mm, more]), covered
        )


def _make_group(tool: TrueTool, sight: Sight, seen: Flags, disturbance: Disturbance) -> Group:
    disturbed = disturbance.sunlight or bool(tool.names & disturbance.interfered)
    if disturbed:
        sight = Sight(sight.mean_mm, sight.sigma_mm * SUNLIGHT_NOISE)
    return Group(sight, np.nonzero(seen.all(axis=0))[0].tolist(), disturbed)
