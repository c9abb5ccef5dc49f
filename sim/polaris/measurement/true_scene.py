"""True marker positions in the tracker frame, disturbed by faults."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians

import numpy as np

from ronna_hw.patient_frame import PART_NUMBER as PATIENT_FRAME_PART_NUMBER
from ronna_hw.x_frame import NAME as X_FRAME_NAME
from ronna_hw.x_frame import PART_NUMBER as X_FRAME_PART_NUMBER
from sim.polaris.measurement.line_of_sight import ArmBody, OpaqueBody, head_ellipsoid
from sim.polaris.unit.tool_definition import ToolDefinition
from sim.world.displacements import (
    NOTHING_MOVED,
    RoomShift,
    ShiftedRoom,
    rigid_move,
    spheres_in_theatre,
    yielding_flange,
)
from sim.world.faults import Fault, FaultBoard
from sim.world.options import ArmRole
from sim.world.rigid import Matrix, Vectors, apply, inverse, matrix_of, rotation_from_vector
from sim.world.scene.model import TrackerTool
from sim.world.scene.parts import (
    ASSISTANT_FRAME_PART_NUMBER,
    GUIDE_FRAME_MARKERS_MM,
    GUIDE_FRAME_NAME,
    GUIDE_FRAME_PART_NUMBER,
)
from sim.world.truth import TrueGuide
from sim.world.world import ArmState, World

Vector = tuple[float, float, float]
NO_TOOL = 0
MILLISECONDS_PER_SECOND = 1e3
SUNLIGHT_REFLECTIONS = 6  # reflections added by sunlight; an estimate without a source


@dataclass(frozen=True)
class TrueTool:
    """A tool in the room: names, marker positions (n, 3) and covered markers."""

    names: frozenset[str]
    markers_mm: Vectors
    covered: tuple[int, ...]  # rows


class TrueScene:
    """Noise-free scene, with static parts computed once and the arm read for each frame."""

    def __init__(self, world: World) -> None:
        scene = world.scene
        self._world = world
        self._tracker_from_robot = inverse(matrix_of(scene.tracker.robot_from_tracker))
        self._flange_from_marker = matrix_of(scene.mount.flange_from_tool_true) @ matrix_of(
            scene.mount.tool_from_marker_true
        )
        self._places = tuple(matrix_of(place) for place in scene.tracker.places)
        self._tools = {tool.part_number: tool for tool in scene.tracker.tools}
        self._markers_mm = {name: np.array(tool.markers_mm) for name, tool in self._tools.items()}
        self.frame_on_mount: TrackerTool = scene.tracker.tools[0]
        self.strays_mm: Vectors = np.array(scene.tracker.strays_mm, dtype=float).reshape(-1, 3)
        fiducials = spheres_in_theatre(scene) if scene.tracker.fiducials_visible else ()
        self.fiducial_numbers = tuple(fiducial.number for fiducial in fiducials)
        centres = np.array([fiducial.centre_ct_mm for fiducial in fiducials], dtype=float).reshape(-1, 3)
        self._centres_mm = apply(matrix_of(scene.head.robot_from_ct), centres)  # robot frame
        on_head = [one.number for one in scene.head.fiducials]
        self._frame_rows = (
            [self.fiducial_numbers.index(one) if one in self.fiducial_numbers else None for one in on_head]
            if scene.head.x_frame
            else []
        )
        self.fiducials_mm: Vectors = self.fiducials_at(NOTHING_MOVED)
        self._arm_body = ArmBody(scene)
        self._holders = scene.holders
        self._holder_bodies = {role: ArmBody(scene, role) for role in scene.holders}
        self._room = ShiftedRoom(world)
        on_guide = scene.mount.guide.tip_from_frame
        self._tip_from_frame = None if on_guide is None else matrix_of(on_guide)
        on_clamp = scene.head.robot_from_patient_frame
        self._robot_from_patient_frame = None if on_clamp is None else matrix_of(on_clamp)
        self._guide = TrueGuide(world)
        has_head = scene.tracker.fiducials_visible and bool(fiducials or scene.head.face or scene.head.own_ct)
        self._head: tuple[OpaqueBody, ...] = (
            (head_ellipsoid(scene.head, self._tracker_from_robot),) if has_head else ()
        )

    def arm(self, role: ArmRole = ArmRole.MASTER) -> ArmState | None:
        """Return an arm's state, or None if the world has no such arm."""
        arm = self._world.arm(role)
        return arm if arm.robot_from_flange[:3].any() else None

    def mounted_tool(self) -> int:
        """Return the number of the mounted tool."""
        return self._world.mounted_tool()

    def fiducials_at(self, room: RoomShift) -> Vectors:
        """Return the fiducials (n, 3), displaced by the room's faults."""
        return apply(
            self._tracker_from(room), room.displace_spheres_mm(self._centres_mm, self.fiducial_numbers)
        )

    def expose_fiducials(self, room: RoomShift) -> Vectors:
        """Return the fiducials (n, 3), each displaced as it is when its turn to be exposed comes."""
        interval_s = self._world.scene.tracker.sphere_interval_ms / MILLISECONDS_PER_SECOND
        if interval_s == 0.0 or room is NOTHING_MOVED:
            return self.fiducials_at(room)
        rooms = [self._room.now(place * interval_s) for place in range(len(self.fiducial_numbers))]
        return np.array([self.fiducials_at(later)[place] for place, later in enumerate(rooms)])

    def extra_spheres_at(self, room: RoomShift) -> Vectors:
        """Return further spheres (n, 3) that rest in the room, on no head."""
        places = np.array(room.extra_spheres_mm, dtype=float).reshape(-1, 3)
        return apply(self._tracker_from(room), places)

    def bodies(
        self, arm: ArmState | None, mounted_tool: int, room: RoomShift = NOTHING_MOVED
    ) -> tuple[OpaqueBody, ...]:
        """Return the opaque bodies: the head at its scene position, and the arm."""
        tracker_from_robot = self._tracker_from(room)
        bodies = [*self._head]
        if arm is not None:
            bodies.append(self._arm_body.capsules(arm, mounted_tool, tracker_from_robot))
        for role, body in self._holder_bodies.items():
            if (holder := self.arm(role)) is not None:
                base = tracker_from_robot @ self._room.robot_from_base(role, room)
                bodies.append(body.capsules(holder, NO_TOOL, base))
        return tuple(bodies)

    def is_mount_frame(self, definition: ToolDefinition) -> bool:
        """Return whether the definition is the reference frame M and an arm is present to carry it."""
        return definition.part_number == self.frame_on_mount.part_number and self.arm() is not None

    def is_on_mount(self, tool: TrueTool) -> bool:
        """Return whether a tool sits on posts on the arm's mount or guide, which cannot hide it."""
        return not tool.names.isdisjoint({self.frame_on_mount.part_number, GUIDE_FRAME_PART_NUMBER})

    def tool(
        self, definition: ToolDefinition, place: int | None, arm: ArmState | None, disturbance: Disturbance
    ) -> TrueTool | None:
        """Return the actual tool for a loaded definition, from which it may differ, or None if absent."""
        if arm is not None and definition.part_number == self.frame_on_mount.part_number:
            return self.frame(arm, disturbance)
        if definition.part_number == GUIDE_FRAME_PART_NUMBER and self._tip_from_frame is not None:
            return self._frame_on_guide(self._tip_from_frame, arm, disturbance)
        if definition.part_number == ASSISTANT_FRAME_PART_NUMBER and self._holders:
            return self._frame_on_holder(ArmRole.ASSISTANT, disturbance)
        if self.is_head_frame(definition):
            return self._frame_on_head(disturbance)
        if definition.part_number == PATIENT_FRAME_PART_NUMBER:
            on_clamp = self.frame_on_clamp(disturbance)
            if on_clamp is not None:
                return on_clamp
        if place is None or place >= len(self._places):
            return None
        if definition.part_number in self._tools:
            return self._place_tool(definition.part_number, self._places[place], disturbance)
        names = frozenset({definition.part_number})
        return _disturb(names, self._places[place], definition.markers_mm, disturbance)

    def is_head_frame(self, definition: ToolDefinition) -> bool:
        """Return whether the definition is the x-shaped frame and its spheres are on the head."""
        return bool(self._frame_rows) and definition.part_number == X_FRAME_PART_NUMBER

    def _frame_on_head(self, disturbance: Disturbance) -> TrueTool:
        """Return the x-shaped frame with its refitted spheres, treating missing spheres as covered."""
        names = frozenset({X_FRAME_NAME, X_FRAME_PART_NUMBER})
        places = self.fiducials_at(disturbance.room)
        there = [row for row in self._frame_rows if row is not None]
        markers = np.array([places[there[0] if row is None else row] for row in self._frame_rows])
        covered = {
            place
            for place, row in enumerate(self._frame_rows)
            if row is None or self.fiducial_numbers[row] in disturbance.hidden_fiducials
        }
        covered |= {number - 1 for name, number in disturbance.hidden_tool_markers if name in names}
        hidden = range(len(markers)) if names & disturbance.hidden_tools else sorted(covered)
        return TrueTool(names, markers, tuple(hidden))

    def frame(self, arm: ArmState, disturbance: Disturbance) -> TrueTool:
        """Return the reference frame M on the mount, even if no host has loaded it."""
        flange = yielding_flange(arm.robot_from_flange, self._flange_from_marker, disturbance.room)
        pose = self._tracker_from(disturbance.room) @ flange @ self._flange_from_marker
        return self._place_tool(self.frame_on_mount.part_number, pose, disturbance)

    def frames(self, arm: ArmState | None, disturbance: Disturbance) -> tuple[TrueTool, ...]:
        """Return every frame of spheres in the room, loaded or not: mount, clamp, guide and assistant."""
        on_guide = self._tip_from_frame
        found = (
            None if arm is None else self.frame(arm, disturbance),
            self.frame_on_clamp(disturbance),
            None if on_guide is None else self._frame_on_guide(on_guide, arm, disturbance),
            self._frame_on_holder(ArmRole.ASSISTANT, disturbance) if self._holders else None,
        )
        return tuple(one for one in found if one is not None)

    def tracker_from_robot(self, room: RoomShift) -> Matrix:
        """Return TRACKER <- ROBOT (4, 4) with the displacements of a room."""
        return self._tracker_from(room)

    def frame_on_clamp(self, disturbance: Disturbance) -> TrueTool | None:
        """Return the patient's frame, even if no host has loaded it, or None without one.

        It moves with the head, as the clamp holds both, unless the head slips in the clamp.
        """
        if self._robot_from_patient_frame is None:
            return None
        room = disturbance.room
        pose = self._tracker_from(room) @ room.move_of_clamp()
        return self._place_tool(PATIENT_FRAME_PART_NUMBER, pose @ self._robot_from_patient_frame, disturbance)

    def _frame_on_guide(
        self, tip_from_frame: Matrix, arm: ArmState | None, disturbance: Disturbance
    ) -> TrueTool | None:
        """Return the frame on the mounted guide, sharing its seating but not its bend."""
        if arm is None or self.mounted_tool() != self._world.scene.mount.tool_number_guide:
            return None
        pose = self._tracker_from(disturbance.room) @ self._guide.bore_frame(arm.robot_from_flange)
        names = frozenset({GUIDE_FRAME_NAME, GUIDE_FRAME_PART_NUMBER})
        return _disturb(names, pose @ tip_from_frame, np.array(GUIDE_FRAME_MARKERS_MM), disturbance)

    def _frame_on_holder(self, role: ArmRole, disturbance: Disturbance) -> TrueTool | None:
        arm, room = self.arm(role), disturbance.room
        if arm is None:
            return None
        base = self._tracker_from(room) @ self._room.robot_from_base(role, room)
        pose = base @ arm.robot_from_flange @ matrix_of(self._holders[role].flange_from_frame)
        return self._place_tool(ASSISTANT_FRAME_PART_NUMBER, pose, disturbance)

    def _place_tool(self, part_number: str, pose: Matrix, disturbance: Disturbance) -> TrueTool:
        names = frozenset({self._tools[part_number].name, part_number})
        return _disturb(names, pose, self._markers_mm[part_number], disturbance)

    def _tracker_from(self, room: RoomShift) -> Matrix:
        """Return TRACKER <- ROBOT (4, 4), with the tracker displaced by the room's faults."""
        if room is NOTHING_MOVED:
            return self._tracker_from_robot
        return self._tracker_from_robot @ inverse(rigid_move(room.tracker_rad, room.tracker_mm))


def _disturb(names: frozenset[str], pose: Vectors, markers_mm: Vectors, disturbance: Disturbance) -> TrueTool:
    for name, push_mm in disturbance.bent:
        if name in names:
            outwards = markers_mm[-1] - markers_mm.mean(axis=0)
            push = outwards * (push_mm / np.linalg.norm(outwards))
            markers_mm = np.vstack([markers_mm[:-1], markers_mm[-1] + push])
    for name, angle_deg in disturbance.turned:
        if name in names:
            pose = pose.copy()
            pose[:3, :3] = pose[:3, :3] @ rotation_from_vector((radians(angle_deg), 0.0, 0.0))
    places = markers_mm @ pose[:3, :3].T + pose[:3, 3]
    for name, way_mm in disturbance.moved:
        if name in names:
            places = places + way_mm
    if names & disturbance.hidden_tools:
        covered = tuple(range(len(places)))
    else:
        covered = tuple(number - 1 for name, number in disturbance.hidden_tool_markers if name in names)
    return TrueTool(names, places, covered)


@dataclass(frozen=True)
class Disturbance:
    """Effects of active faults on markers and light, comparable between frames.

    Tools are given by name or part number.
    """

    hidden_fiducials: frozenset[int] = frozenset()
    hidden_tools: frozenset[str] = frozenset()
    hidden_tool_markers: frozenset[tuple[str, int]] = frozenset()  # marker counted from 1
    bent: tuple[tuple[str, float], ...] = ()  # sideways displacement of the last marker, mm
    turned: tuple[tuple[str, float], ...] = ()  # about the x axis of the tool, degrees
    moved: tuple[tuple[str, Vector], ...] = ()  # in the tracker frame, mm
    interfered: frozenset[str] = frozenset()
    strays: int = 0
    reflections: int = 0
    line_separation_mm: float = 0.0
    sunlight: bool = False
    room: RoomShift = NOTHING_MOVED

    def count_reflections(self, usual: int) -> int:
        """Return how many surfaces reflect, with the `usual` ones of the scene."""
        return usual + self.reflections + (SUNLIGHT_REFLECTIONS if self.sunlight else 0)


UNDISTURBED = Disturbance()


class Disturbances:
    """Combines the effects of active tracker and room faults."""

    def __init__(self, board: FaultBoard, room: ShiftedRoom) -> None:
        self._board = board
        self._room = room

    def now(self) -> Disturbance:
        """Return the current effects, or `UNDISTURBED` after a single look-up if there are none."""
        board, room = self._board, self._room.now()
        if board.empty and room is NOTHING_MOVED:
            return UNDISTURBED
        found = Disturbance(
            hidden_fiducials=frozenset(int(fault.argument) for fault in board.active("occlude_marker")),
            hidden_tools=_tool_names(board.active("occlude_tool")),
            hidden_tool_markers=frozenset(
                (fault.arguments[0], int(fault.arguments[1])) for fault in board.active("occlude_tool_marker")
            ),
            bent=_amounts_by_tool(board.active("bend_tool")),
            turned=_amounts_by_tool(board.active("turn_tool")),
            moved=tuple((fault.arguments[0], _argument_vector(fault)) for fault in board.active("move_tool")),
            interfered=_tool_names(board.active("interference")),
            strays=sum(int(fault.argument) for fault in board.active("strays")),
            reflections=sum(int(fault.argument) for fault in board.active("reflections")),
            line_separation_mm=max((float(f.argument) for f in board.active("phantoms")), default=0.0),
            sunlight=bool(board.active("sunlight")),
            room=room,
        )
        return UNDISTURBED if found == UNDISTURBED else found


def _tool_names(faults: tuple[Fault, ...]) -> frozenset[str]:
    return frozenset(fault.argument for fault in faults)


def _amounts_by_tool(faults: tuple[Fault, ...]) -> tuple[tuple[str, float], ...]:
    return tuple((fault.arguments[0], float(fault.arguments[1])) for fault in faults)


def _argument_vector(fault: Fault) -> Vector:
    x, y, z = (float(value) for value in fault.arguments[1:])
    return x, y, z
