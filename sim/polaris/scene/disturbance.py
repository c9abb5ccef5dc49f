"""Effects of the active faults on markers and ambient light."""

from __future__ import annotations

from dataclasses import dataclass

from sim.world.faults import Fault, FaultBoard
from sim.world.room_shift import NOTHING_MOVED, RoomShift, ShiftedRoom

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Disturbance:
    """All effects as one value, comparable between frames. Tools by name or part number."""

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


NONE = Disturbance()


class Disturbances:
    """Collects effects from the fault boards of the tracker and the room."""

    def __init__(self, board: FaultBoard, room: ShiftedRoom) -> None:
        self._board = board
        self._room = room

    def now(self) -> Disturbance:
        """The current effects; `NONE` after one look-up if there are no faults."""
        board, room = self._board, self._room.now()
        if board.empty and room is NOTHING_MOVED:
            return NONE
        found = Disturbance(
            hidden_fiducials=frozenset(int(fault.argument) for fault in board.active("occlude_marker")),
            hidden_tools=_names(board.active("occlude_tool")),
            hidden_tool_markers=frozenset(
                (fault.arguments[0], int(fault.arguments[1])) for fault in board.active("occlude_tool_marker")
            ),
            bent=tuple(
                (fault.arguments[0], float(fault.arguments[1])) for fault in board.active("bend_tool")
            ),
            turned=tuple(
                (fault.arguments[0], float(fault.arguments[1])) for fault in board.active("turn_tool")
            ),
            moved=tuple((fault.arguments[0], _vector(fault)) for fault in board.active("move_tool")),
            interfered=_names(board.active("interference")),
            strays=sum(int(fault.argument) for fault in board.active("strays")),
            reflections=sum(int(fault.argument) for fault in board.active("reflections")),
            line_separation_mm=max((float(f.argument) for f in board.active("phantoms")), default=0.0),
            sunlight=bool(board.active("sunlight")),
            room=room,
        )
        return NONE if found == NONE else found


def _names(faults: tuple[Fault, ...]) -> frozenset[str]:
    return frozenset(fault.argument for fault in faults)


def _vector(fault: Fault) -> Vector:
    x, y, z = (float(value) for value in fault.arguments[1:])
    return x, y, z
