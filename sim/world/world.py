"""Shared world: the scene, the clock and all mutable state of a running theatre.

One block of anonymous memory (a memfd), opened by the other processes through `/proc/<pid>/fd/<n>`: it
disappears with the last process that holds it, however that process ends. The clock has a block of its own,
so that the procedure can open the clock without access to the scene.

Each changing part has a single writer: the robot simulator writes the arm, the theatre's control port the
mounted tool, the instrument in it, the drill, the step and the fault script; the arm that drills writes how
deep the opening is.
"""

from __future__ import annotations

import mmap
import os
import weakref
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ronna_hw.bounded_input import check_json
from ronna_hw.clock import CLOCK, SharedClock
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.host.row_codec import text
from ronna_hw.host.shared_memory import MemoryMap
from ronna_hw.vectors import JointVector
from ronna_hw.wire.room_tasks import OnStand
from sim.errors import WORLD_UNAVAILABLE
from sim.world.options import ArmRole
from sim.world.rigid import matrix_of
from sim.world.scene.model import Scene, parse_scene_json

READ_ATTEMPTS = 100_000  # attempts to read during a write, which takes microseconds
LARGEST_SCENE_BYTES = 10_000_000  # a hundred times the largest scene of ours
FAULTS_CAPACITY_BYTES = 32 * 1024


class ClockRow(NamedTuple):
    """Location of the clock's shared memory block."""

    path: Annotated[str, text(100)]


class ArmRow(NamedTuple):
    """An `ArmState` as plain numbers, with the flange pose row by row."""

    joints_rad: Annotated[JointVector, "6d"]
    flange_rows: Annotated[tuple[float, ...], "12d"]
    motion_number: Annotated[int, "Q"]
    at_rest: Annotated[bool, "?"]
    flanks: Annotated[JointVector, "6d"]
    moved_s: Annotated[float, "d"]


class SharedStep(NamedTuple):
    """The current step as plain data."""

    started_ns: Annotated[int, "q"]  # theatre time
    name: Annotated[str, text(64)]


class InstrumentRow(NamedTuple):
    """The instrument in the guide as plain data."""

    trajectory: Annotated[str, text(64)]  # empty for no instrument


class DrillRow(NamedTuple):
    """The drill in the assistant's holder as plain data."""

    trajectory: Annotated[str, text(64)]  # empty for none
    tip_mm: Annotated[float, "d"]  # beyond the clamp
    turns: Annotated[bool, "?"]


class HungRow(NamedTuple):
    """The test weight on the assistant's holder as plain data."""

    mass_kg: Annotated[float, "d"]  # 0 for none


class OpeningRow(NamedTuple):
    """The opening that was drilled last: its bottom below the skin, and the tip beyond the skull at most."""

    trajectory: Annotated[str, text(64)]
    bottom_mm: Annotated[float, "d"]
    beyond_mm: Annotated[float, "d"]


_MAP = MemoryMap(b"RONNAWLD")
_CLOCK = _MAP.rows(ClockRow)
_ARM_SEQUENCES = tuple(_MAP.word() for _ in ArmRole)  # odd while that arm is being written
_ARMS = _MAP.rows(ArmRow, len(ArmRole))
_TOOL = _MAP.word("I")  # number of the mounted tool, 0 for none
_MOUNTINGS = _MAP.word()
_STAND = _MAP.word("I")  # content of the calibration stand: index in `OnStand`
_INSTRUMENT = _MAP.rows(InstrumentRow)
_DRILL = _MAP.rows(DrillRow)
_OPENING = _MAP.rows(OpeningRow)
_HUNG = _MAP.rows(HungRow)
_STEP = _MAP.rows(SharedStep)
_FAULTS_VERSION = _MAP.word()
_FAULTS = _MAP.checked_bytes(FAULTS_CAPACITY_BYTES)
_SCENE_LENGTH = _MAP.word()
_SCENE_OFFSET = _MAP.size_bytes  # the scene is the rest of the block


class ArmState(NamedTuple):
    """True arm state: encoder angles, and flange pose in the base of the arm."""

    joints_rad: JointVector
    robot_from_flange: NDArray[np.float64]  # (4, 4)
    motion_number: int
    at_rest: bool
    flanks: JointVector = (0.0,) * 6  # position of each joint in its backlash, -1 to 1
    moved_s: float = 0.0  # time in motion so far


class World:
    """View of the shared memory block; the owning process calls `create`, all others call `open`."""

    def __init__(self, path: str, scene: Scene | None = None, role: ArmRole = ArmRole.MASTER) -> None:
        self._path = path
        self.role = role
        self._kept_arms: dict[ArmRole, tuple[ArmRow, ArmState]] = {}
        try:
            file = os.open(path, os.O_RDWR | os.O_CLOEXEC)
            try:
                self._memory = mmap.mmap(file, os.fstat(file).st_size)
            finally:
                os.close(file)
        except (OSError, ValueError) as error:
            raise WORLD_UNAVAILABLE(f"cannot open the world at {path}: {error}") from error
        if not self._is_world():
            raise WORLD_UNAVAILABLE(f"{path} is not a world file of this version")
        self._clock_path = _CLOCK.read(self._memory).path
        self.clock = SharedClock(self._clock_path, role.number)
        if scene is None:
            end = _SCENE_OFFSET + min(_SCENE_LENGTH.read(self._memory), LARGEST_SCENE_BYTES)
            scene = parse_scene_json(check_json(self._memory[_SCENE_OFFSET:end]), f"the scene in {path}")
        self.scene = scene

    @classmethod
    def create(cls, scene: Scene, *, paced: bool, begins_ns: int = 0) -> World:
        """Create a world, which if `paced` follows the host's clock, starting at `begins_ns`.

        Others can open it as long as this object exists.
        """
        content = scene.model_dump_json(by_alias=True).encode()
        clock_file, clock_path, clock_memory = _create_block("ronna-clock", CLOCK.size_bytes)
        with clock_memory:
            SharedClock.initialise(clock_memory, paced=paced, begins_ns=begins_ns)
        file, path, memory = _create_block("ronna-world", _SCENE_OFFSET + len(content))
        with memory:
            _CLOCK.write(memory, ClockRow(clock_path))
            _SCENE_LENGTH.write(memory, len(content))
            memory[_SCENE_OFFSET : _SCENE_OFFSET + len(content)] = content
            _TOOL.write(memory, scene.mount.tool_number_stereo)
            _MAP.mark_memory(memory)
        world = cls(path, scene)
        for block in (clock_file, file):
            weakref.finalize(world, os.close, block)
        return world

    @classmethod
    def open(cls, endpoint: str, role: ArmRole = ArmRole.MASTER) -> World:
        """Open a theatre's world by its `shm://` endpoint; raises SIM-001, SIM-002, CLK-001, INP-001.

        `role` is that of the arm whose cycles this process may stream.
        """
        return cls(parse_endpoint(endpoint).require("shm").path, role=role)

    @property
    def endpoint(self) -> str:
        """World endpoint for devices."""
        return f"shm://{self._path}"

    @property
    def clock_endpoint(self) -> str:
        """Endpoint of the world's clock alone."""
        return f"shm://{self._clock_path}"

    def publish_arm(self, state: ArmState, role: ArmRole | None = None) -> None:
        """Publish an arm's state, by default that of this process' own; for use by its simulator only."""
        role = role or self.role
        memory, count = self._memory, _ARM_SEQUENCES[role.number]
        sequence = count.read(memory)
        count.write(memory, sequence + 1)
        rows = tuple(state.robot_from_flange[:3].ravel().tolist())
        row = ArmRow(state.joints_rad, rows, state.motion_number, state.at_rest, state.flanks, state.moved_s)
        _ARMS.write(memory, row, role.number)
        count.write(memory, sequence + 2)

    def arm(self, role: ArmRole = ArmRole.MASTER) -> ArmState:
        """Read a consistent true arm state (seqlock), even if its writer died while writing.

        The flange is in the arm's own base, which for the master is the robot frame.
        """
        count = _ARM_SEQUENCES[role.number]
        for _ in range(READ_ATTEMPTS):
            before = count.read(self._memory)
            row = _ARMS.read(self._memory, role.number)
            if before % 2 == 0 and before == count.read(self._memory):
                break
        kept = self._kept_arms.get(role)
        if kept is None or kept[0] != row:
            matrix = np.eye(4)
            matrix[:3] = np.reshape(row.flange_rows, (3, 4))
            matrix.flags.writeable = False  # shared by all who ask until the arm changes
            state = ArmState(row.joints_rad, matrix, row.motion_number, row.at_rest, row.flanks, row.moved_s)
            kept = self._kept_arms[role] = (row, state)
        return kept[1]

    def has_arm(self, role: ArmRole = ArmRole.MASTER) -> bool:
        """Return whether the arm's pose has been set."""
        return _ARM_SEQUENCES[role.number].read(self._memory) > 0

    def robot_from_tool(self) -> NDArray[np.float64]:
        """Return the true pose (4, 4) of the stereo head's tool centre point, carried by the arm."""
        pose: NDArray[np.float64] = self.arm().robot_from_flange @ matrix_of(
            self.scene.mount.flange_from_tool_true
        )
        return pose

    def mounted_tool(self) -> int:
        """Return the number of the mounted tool."""
        return _TOOL.read(self._memory)

    def mountings(self) -> int:
        """Return how often the guide has been mounted, since its seating differs slightly each time."""
        return _MOUNTINGS.read(self._memory)

    def mount_tool(self, number: int, mountings: int | None = None) -> None:
        """Mount a tool, possibly the one already mounted; for use by the control port only.

        Mountings of the guide are counted, unless a restored world sets `mountings`.
        """
        _TOOL.write(self._memory, number)
        if mountings is None:
            mountings = self.mountings() + (number == self.scene.mount.tool_number_guide)
        _MOUNTINGS.write(self._memory, mountings)

    def inserted(self) -> str | None:
        """Return the trajectory at which an instrument is in the guide, or None if there is none."""
        return _INSTRUMENT.read(self._memory).trajectory or None

    def put_in_guide(self, trajectory: str | None) -> None:
        """Insert an instrument at a trajectory, or take it out; for use by the control port only."""
        _INSTRUMENT.write(self._memory, InstrumentRow(trajectory or ""))

    def held_drill(self) -> DrillRow | None:
        """Return the drill in the assistant's holder, or None."""
        row = _DRILL.read(self._memory)
        return row if row.trajectory else None

    def hold_drill(self, drill: DrillRow | None) -> None:
        """Put a drill into the assistant's holder, or take it out; for use by the control port only."""
        _DRILL.write(self._memory, drill or DrillRow("", 0.0, False))

    def opening(self) -> OpeningRow:
        """Return the opening that was drilled last; its trajectory is empty for none."""
        return _OPENING.read(self._memory)

    def note_opening(self, trajectory: str, bottom_mm: float, beyond_mm: float) -> None:
        """Note how deep an opening is, and the tip beyond the skull; for use by the arm's simulator only."""
        known = self.opening()
        if known.trajectory == trajectory:
            beyond_mm = max(beyond_mm, known.beyond_mm)
        _OPENING.write(self._memory, OpeningRow(trajectory, bottom_mm, beyond_mm))

    def hung_kg(self) -> float:
        """Return the mass of the test weight on the assistant's holder, 0 without one."""
        return _HUNG.read(self._memory).mass_kg

    def hang_weight(self, mass_kg: float) -> None:
        """Hang a test weight on the assistant's holder, or take it off; for use by the control port only."""
        _HUNG.write(self._memory, HungRow(mass_kg))

    def on_stand(self) -> OnStand:
        """Return the object on the calibration stand."""
        return tuple(OnStand)[_STAND.read(self._memory)]

    def put_on_stand(self, content: OnStand) -> None:
        """Change the object on the calibration stand; for use by the control port only."""
        _STAND.write(self._memory, tuple(OnStand).index(content))

    def step(self) -> tuple[str, int]:
        """Return the name of the current step and its start in theatre time, in ns."""
        row = _STEP.read(self._memory)
        return row.name, row.started_ns

    def enter_step(self, name: str) -> None:
        """Set the current step; for use by the control port only."""
        _STEP.write(self._memory, SharedStep(self.clock.now_ns(), name))

    def fault_version(self) -> int:
        """Return the version of the fault script, which changes with every edit of the text."""
        return _FAULTS_VERSION.read(self._memory)

    def fault_script(self) -> tuple[int, str]:
        """Return the version and text of the fault script.

        Raises SIM-002 if it was left half written.
        """
        for _ in range(READ_ATTEMPTS):
            version, content = _FAULTS_VERSION.read(self._memory), _FAULTS.read(self._memory)
            if content is not None:
                return version, content.decode(errors="replace")
        raise WORLD_UNAVAILABLE("the fault script in the world was left half written")

    def set_fault_script(self, script: str) -> None:
        """Replace the fault script with text already checked; for use by the control port only."""
        content = script.encode()
        if len(content) > FAULTS_CAPACITY_BYTES:
            raise WORLD_UNAVAILABLE("the fault script is too long", limit=f"{FAULTS_CAPACITY_BYTES} bytes")
        _FAULTS.write(self._memory, content)
        _FAULTS_VERSION.write(self._memory, _FAULTS_VERSION.read(self._memory) + 1)

    def _is_world(self) -> bool:
        if len(self._memory) < _SCENE_OFFSET or not _MAP.is_marked(self._memory):
            return False
        return _STAND.read(self._memory) < len(OnStand)


def _create_block(name: str, size: int) -> tuple[int, str, mmap.mmap]:
    """Create an anonymous block and return its file, its path (valid while open) and its memory."""
    file = os.memfd_create(name, os.MFD_CLOEXEC)
    os.ftruncate(file, size)
    return file, f"/proc/{os.getpid()}/fd/{file}", mmap.mmap(file, size)
