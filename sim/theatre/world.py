"""The shared world: the scene, the clock, and what changes while the theatre runs.

One block of anonymous memory (a memfd), opened by the other processes through `/proc/<pid>/fd/<n>`:
it vanishes with the last process that holds it, however that process ends. The clock lies in a block of its
own: the procedure opens the clock, and nothing of the scene lies beside it.

What changes has one writer each: the arm is written by the robot simulator, the mounted tool, the step and
the fault script by the theatre's control port.
"""

from __future__ import annotations

import mmap
import os
import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ronna_hw.clock import SharedClock
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.wire.theatre_clock import CLOCK_BYTES
from sim.errors import WorldUnavailable
from sim.theatre.rigid import matrix_of
from sim.theatre.scene.model import Scene

MAGIC = b"RONNAWLD"
MAGIC_OFFSET = 0
CLOCK_PATH_OFFSET = 16
ARM_SEQUENCE_OFFSET = 128  # u64, odd while the arm is being written
ARM_OFFSET = 136
TOOL_OFFSET = 512  # u32 number of the mounted tool, 0 nothing
STEP_OFFSET = 520
FAULTS_OFFSET = 1024
FAULTS_CAPACITY = 32 * 1024
SCENE_OFFSET = FAULTS_OFFSET + FAULTS_CAPACITY

_clock_path = struct.Struct("<100s")
_sequence = struct.Struct("<Q")
_arm = struct.Struct("<6d12dQI")  # encoder joints rad, flange pose rows, motion number, at rest
_tool = struct.Struct("<I")
_step = struct.Struct("<q64s")  # theatre time of its start, name
_faults = struct.Struct("<II")  # version, length of the text that follows
_scene_length = struct.Struct("<I")


@dataclass(frozen=True)
class ArmState:
    """Where the arm truly is: encoder angles, and the flange in the robot frame."""

    joints_rad: tuple[float, float, float, float, float, float]
    robot_from_flange: NDArray[np.float64]  # (4, 4)
    motion_number: int
    at_rest: bool


class World:
    """A view of the shared block. Made by `create` in the process that owns it, by `open` elsewhere."""

    def __init__(self, path: str, scene: Scene | None = None) -> None:
        self._path = path
        try:
            self._file = os.open(path, os.O_RDWR | os.O_CLOEXEC)
            self._memory = mmap.mmap(self._file, os.fstat(self._file).st_size)
        except (OSError, ValueError) as error:
            raise WorldUnavailable(f"cannot open the world at {path}: {error}") from error
        if self._memory[MAGIC_OFFSET : MAGIC_OFFSET + 8] != MAGIC:
            raise WorldUnavailable(f"{path} is not a world of this version")
        self._clock_path = _clock_path.unpack_from(self._memory, CLOCK_PATH_OFFSET)[0].rstrip(b"\0").decode()
        self.clock = SharedClock(self._clock_path)
        self.scene = scene or self._read_scene()

    @classmethod
    def create(cls, scene: Scene, *, paced: bool) -> World:
        """Make a world of `scene`; `paced` worlds follow the host's clock."""
        text = scene.model_dump_json(by_alias=True).encode()
        size = SCENE_OFFSET + _scene_length.size + len(text)
        clock_path, clock_memory = _block("ronna-clock", CLOCK_BYTES)
        with clock_memory:
            SharedClock.initialise(clock_memory, paced=paced)
        path, memory = _block("ronna-world", size)
        with memory:
            _clock_path.pack_into(memory, CLOCK_PATH_OFFSET, clock_path.encode())
            _scene_length.pack_into(memory, SCENE_OFFSET, len(text))
            start = SCENE_OFFSET + _scene_length.size
            memory[start : start + len(text)] = text
            _tool.pack_into(memory, TOOL_OFFSET, scene.mount.tool_number_stereo)
            memory[MAGIC_OFFSET : MAGIC_OFFSET + 8] = MAGIC
        return cls(path, scene)

    @classmethod
    def open(cls, endpoint: str) -> World:
        """Open the world of a theatre by its `shm://` endpoint; raises SIM-002."""
        return cls(parse_endpoint(endpoint).require("shm").path)

    @property
    def endpoint(self) -> str:
        """Where the devices open this world."""
        return f"shm://{self._path}"

    @property
    def clock_endpoint(self) -> str:
        """Where the clock of this world, and nothing else, is opened."""
        return f"shm://{self._clock_path}"

    def publish_arm(self, state: ArmState) -> None:
        """Publish where the arm is. For the robot simulator only."""
        sequence = _sequence.unpack_from(self._memory, ARM_SEQUENCE_OFFSET)[0]
        _sequence.pack_into(self._memory, ARM_SEQUENCE_OFFSET, sequence + 1)
        _arm.pack_into(
            self._memory,
            ARM_OFFSET,
            *state.joints_rad,
            *state.robot_from_flange[:3].ravel().tolist(),
            state.motion_number,
            int(state.at_rest),
        )
        _sequence.pack_into(self._memory, ARM_SEQUENCE_OFFSET, sequence + 2)

    def arm(self) -> ArmState:
        """Where the arm truly is, read whole (seqlock)."""
        while True:
            before = _sequence.unpack_from(self._memory, ARM_SEQUENCE_OFFSET)[0]
            values = _arm.unpack_from(self._memory, ARM_OFFSET)
            if before % 2 == 0 and before == _sequence.unpack_from(self._memory, ARM_SEQUENCE_OFFSET)[0]:
                break
        matrix = np.eye(4)
        matrix[:3] = np.reshape(values[6:18], (3, 4))
        a1, a2, a3, a4, a5, a6 = values[:6]
        return ArmState((a1, a2, a3, a4, a5, a6), matrix, values[18], bool(values[19]))

    def robot_from_tool(self) -> NDArray[np.float64]:
        """True pose (4, 4) of the stereo head's tool centre point: moves with the arm."""
        pose: NDArray[np.float64] = self.arm().robot_from_flange @ matrix_of(
            self.scene.mount.flange_from_tool_true
        )
        return pose

    def mounted_tool(self) -> int:
        """Number of the mounted tool."""
        return int(_tool.unpack_from(self._memory, TOOL_OFFSET)[0])

    def mount_tool(self, number: int) -> None:
        """Mount another tool. For the control port only."""
        _tool.pack_into(self._memory, TOOL_OFFSET, number)

    def step(self) -> tuple[str, int]:
        """Name of the running step and the theatre time of its start in ns."""
        started_ns, name = _step.unpack_from(self._memory, STEP_OFFSET)
        return name.rstrip(b"\0").decode(), started_ns

    def enter_step(self, name: str) -> None:
        """Set the running step. For the control port only."""
        _step.pack_into(self._memory, STEP_OFFSET, self.clock.now_ns(), name.encode()[:64])

    def fault_version(self) -> int:
        """Version of the fault script; it changes with every change of the text."""
        return int(_faults.unpack_from(self._memory, FAULTS_OFFSET)[0])

    def fault_script(self) -> tuple[int, str]:
        """Version and text of the fault script; the version changes with every change of the text."""
        version, length = _faults.unpack_from(self._memory, FAULTS_OFFSET)
        start = FAULTS_OFFSET + _faults.size
        return version, self._memory[start : start + length].decode()

    def set_fault_script(self, text: str) -> None:
        """Replace the fault script. For the control port only; the text has been checked before."""
        content = text.encode()
        if len(content) > FAULTS_CAPACITY - _faults.size:
            raise WorldUnavailable("the fault script is too long", limit=f"{FAULTS_CAPACITY} bytes")
        version = _faults.unpack_from(self._memory, FAULTS_OFFSET)[0]
        start = FAULTS_OFFSET + _faults.size
        self._memory[start : start + len(content)] = content
        _faults.pack_into(self._memory, FAULTS_OFFSET, version + 1, len(content))

    def _read_scene(self) -> Scene:
        length = _scene_length.unpack_from(self._memory, SCENE_OFFSET)[0]
        start = SCENE_OFFSET + _scene_length.size
        return Scene.model_validate_json(self._memory[start : start + length], strict=False)


def _block(name: str, size: int) -> tuple[str, mmap.mmap]:
    """Path for other processes, and memory, of a new anonymous block; it stays open in this process."""
    file = os.memfd_create(name, os.MFD_CLOEXEC)
    os.ftruncate(file, size)
    return f"/proc/{os.getpid()}/fd/{file}", mmap.mmap(file, size)
