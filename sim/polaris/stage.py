"""Where the markers truly are, in the tracker frame: the scene seen from the unit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.polaris.definition import ToolDefinition
from sim.theatre.rigid import apply, inverse, matrix_of
from sim.theatre.scene import TrackerTool
from sim.theatre.world import World

Vectors = NDArray[np.float64]


class Stage:
    """The room without noise. What never moves is computed once; the arm is looked up for each frame."""

    def __init__(self, world: World) -> None:
        scene = world.scene
        self._world = world
        self._tracker_from_robot = inverse(matrix_of(scene.tracker.robot_from_tracker))
        self._tool_from_marker = matrix_of(scene.mount.flange_from_tool_true) @ matrix_of(
            scene.mount.tool_from_marker_true
        )
        self._places = tuple(matrix_of(place) for place in scene.tracker.places)
        self._tools = {tool.part_number: tool for tool in scene.tracker.tools}
        self.frame_on_mount: TrackerTool = scene.tracker.tools[0]
        self.frame_markers_mm: Vectors = np.array(self.frame_on_mount.markers_mm)
        self.strays_mm: Vectors = np.array(scene.tracker.strays_mm, dtype=float).reshape(-1, 3)
        fiducials = scene.head.fiducials if scene.tracker.fiducials_visible else ()
        self.fiducial_numbers = tuple(fiducial.number for fiducial in fiducials)
        centres = np.array([fiducial.centre_ct_mm for fiducial in fiducials], dtype=float).reshape(-1, 3)
        self.fiducials_mm: Vectors = apply(
            self._tracker_from_robot @ matrix_of(scene.head.robot_from_ct), centres
        )

    def hangs_on_mount(self, definition: ToolDefinition) -> bool:
        """True for the reference frame M, as long as there is an arm that carries it."""
        return definition.part_number == self.frame_on_mount.part_number and self.mount_pose() is not None

    def pose(self, definition: ToolDefinition, place: int | None) -> Vectors | None:
        """True pose (4, 4) tracker <- tool of a loaded tool; None when it is not in the room."""
        if definition.part_number == self.frame_on_mount.part_number:
            on_mount = self.mount_pose()
            if on_mount is not None:
                return on_mount
        if place is None or place >= len(self._places):
            return None
        return self._places[place]

    def mount_pose(self) -> Vectors | None:
        """True pose (4, 4) tracker <- M on the mount; None without an arm."""
        robot_from_flange = self._world.arm().robot_from_flange
        if not robot_from_flange[:3].any():
            return None
        pose: Vectors = self._tracker_from_robot @ robot_from_flange @ self._tool_from_marker
        return pose

    def markers_mm(self, definition: ToolDefinition) -> Vectors:
        """Where the markers (n, 3) really sit on the tool, whatever definition was loaded for it."""
        tool = self._tools.get(definition.part_number)
        return definition.markers_mm if tool is None else np.array(tool.markers_mm)

    def name(self, definition: ToolDefinition) -> str:
        """Name of the tool in the scene, or its part number."""
        tool = self._tools.get(definition.part_number)
        return definition.part_number if tool is None else tool.name
