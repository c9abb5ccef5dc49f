"""Visible markers, cached while nothing moves: tools, other spheres and phantoms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.polaris.optics.marker_noise import Optics, Sight, eyes_mm, in_field
from sim.polaris.optics.measuring_volume import Volume
from sim.polaris.optics.phantoms import phantoms
from sim.polaris.scene.disturbance import Disturbance
from sim.polaris.scene.extra_strays import extra_strays
from sim.polaris.scene.line_of_sight import Flags, visible
from sim.polaris.scene.true_scene import TrueScene, TrueTool
from sim.polaris.tools.ports import Port
from sim.world.world import ArmState

SUNLIGHT_NOISE = 2.0  # factor on the noise under ambient infrared light; an estimate without a source


@dataclass(frozen=True)
class Group:
    """Markers of one tool: their measurement errors, and the rows that both sensors see."""

    sight: Sight
    seen: list[int]
    disturbed: bool = False  # by infrared light


@dataclass(frozen=True)
class VisibleMarkers:
    """All markers in view. `tools` by handle: None for a handle without markers or a tool not in the room."""

    tools: dict[int, Group | None]
    frame: Group | None  # reference frame M unless a handle has its definition
    fixed: Group
    phantoms: Group


class MarkerVisibility:
    """Computes the visible markers when something has moved, and caches them in between."""

    def __init__(self, scene: TrueScene, optics: Optics, seed: int, volume: Volume, line_mm: float) -> None:
        self._scene = scene
        self._optics = optics
        self._seed = seed
        self._volume = volume
        self._line_separation_mm = line_mm
        self._key: object = None
        self._kept: VisibleMarkers | None = None

    def forget(self) -> None:
        """Drop the cache: the handles changed."""
        self._kept = None

    def now(self, ports: tuple[Port, ...], disturbance: Disturbance) -> VisibleMarkers:
        """The visible markers for these enabled ports."""
        arm, mounted = self._scene.arm(), self._scene.mounted_tool()
        key = (None if arm is None else arm.robot_from_flange.tobytes(), mounted, disturbance)
        if self._kept is None or key != self._key:
            self._kept = self._computed(ports, disturbance, arm, mounted)
            self._key = key
        return self._kept

    def _computed(
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
        on_head = any(port.definition is not None and scene.stands_on_head(port.definition) for port in ports)
        fixed = self._fixed(disturbance, as_tool=on_head)

        groups = [fixed, *(tool for tool in (*tools.values(), frame) if tool is not None)]
        points = np.vstack([group.markers_mm for group in groups])
        seen = visible(eyes_mm(), points, scene.bodies(arm, mounted, disturbance.room))
        bodies_past_mount = scene.bodies(arm, mounted, disturbance.room, past_mount=True)
        ends = np.cumsum([len(group.markers_mm) for group in groups]).tolist()
        for group, end in zip(groups, ends, strict=True):
            first = end - len(group.markers_mm)
            if scene.on_mount(group):
                seen[:, first:end] = visible(eyes_mm(), points[first:end], bodies_past_mount)
            seen[:, [first + row for row in group.covered]] = False
        seen &= in_field(points)
        rows = {
            id(group): seen[:, end - len(group.markers_mm) : end]
            for group, end in zip(groups, ends, strict=True)
        }

        def group_of(tool: TrueTool | None) -> Group | None:
            return None if tool is None else self._group(tool, rows[id(tool)], disturbance)

        ghosts = phantoms(
            eyes_mm(), points, seen, max(self._line_separation_mm, disturbance.line_separation_mm)
        )
        ghost_group = Group(self._optics.sight(ghosts), list(range(len(ghosts))))
        return VisibleMarkers(
            tools={handle: group_of(tool) for handle, tool in tools.items()},
            frame=group_of(frame),
            fixed=self._group(fixed, rows[id(fixed)], disturbance),
            phantoms=ghost_group,
        )

    def _fixed(self, disturbance: Disturbance, *, as_tool: bool) -> TrueTool:
        """Spheres that belong to no tool: the fiducials, unless they are a tool's, and others."""
        scene = self._scene
        more = extra_strays(self._seed, disturbance.strays, self._volume)
        if as_tool:
            return TrueTool(frozenset(), np.vstack([scene.strays_mm, more]), ())
        covered = tuple(
            row for row, number in enumerate(scene.fiducial_numbers) if number in disturbance.hidden_fiducials
        )
        return TrueTool(
            frozenset(), np.vstack([scene.fiducials_at(disturbance.room), scene.strays_mm, more]), covered
        )

    def _group(self, tool: TrueTool, seen: Flags, disturbance: Disturbance) -> Group:
        sight = self._optics.sight(tool.markers_mm)
        disturbed = disturbance.sunlight or bool(tool.names & disturbance.interfered)
        if disturbed:
            sight = Sight(sight.mean_mm, sight.sigma_mm * SUNLIGHT_NOISE)
        return Group(sight, np.nonzero(seen.all(axis=0))[0].tolist(), disturbed)
