"""Saved world state from which another theatre can continue: arm, tool, instrument and time.

The file is written when the theatre starts, at each step and task of the staff, and when it ends, also if
its parent died: a killed theatre continues from its last step or task. It includes what faults have moved,
bent or rotated; a continued world has no other fault until one is injected.
"""

from __future__ import annotations

import fcntl
import math
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from operator import itemgetter
from pathlib import Path
from typing import Annotated, cast

import numpy as np
from pydantic import Field, ValidationError

from ronna_hw.bounded_input import read_json_bytes
from ronna_hw.calibration import Strict
from ronna_hw.mistakes import describe_mistakes
from ronna_hw.records import write_atomically
from sim.errors import BAD_SAVED_WORLD, THEATRE_RUNNING
from sim.world.carts import finished
from sim.world.displacements import list_cart_rolls_mm
from sim.world.faults import parse_faults
from sim.world.faults.board import FaultBoard, format_beginning
from sim.world.faults.camera import TWIST
from sim.world.faults.room import CART, MOVE, PUSH, PUSH_OVER, ROOM_FAULTS
from sim.world.faults.room import DEVICE as ROOM
from sim.world.faults.tracker import DISPLACED_TOOLS
from sim.world.options import ArmRole
from sim.world.scene.model import Numbers6, Scene
from sim.world.slow_faults import come_to, still_to_come
from sim.world.world import ArmState, DrillRow, World

WORLD_FILE = "world.json"
EXPECTED = "the arm, tool and time that the theatre saved"

END_LIMIT_S = 4.0  # host time; a theatre whose parent died ends within two seconds
RETRY_S = 0.02
Count = Annotated[int, Field(ge=0)]


class SavedArm(Strict):
    """Robot state: encoders, plus hidden state that they do not show."""

    joints_rad: Numbers6 = Field(description="Encoder angles.")
    flanks: Numbers6 = Field(description="Position of each joint within its backlash, -1 to 1.")
    motion_number: Count = Field(description="Number of motions so far.")
    moved_s: Annotated[float, Field(ge=0)] = Field(description="Time in motion so far.")

    @classmethod
    def from_world(cls, world: World, role: ArmRole) -> SavedArm | None:
        """Capture the present state of an arm, or return None before it has started."""
        if not world.has_arm(role):
            return None
        arm = world.arm(role)
        return cls(
            joints_rad=cast("Numbers6", arm.joints_rad),
            flanks=cast("Numbers6", arm.flanks),
            motion_number=arm.motion_number,
            moved_s=arm.moved_s,
        )


class SavedWorld(Strict):
    """All mutable state of a world."""

    theatre_time_ns: Count = Field(description="Time since the theatre was first started.")
    mounted_tool: Count = Field(description="Mounted tool as the controller's inputs report it.")
    mountings: Count = Field(default=0, description="How often the guide was mounted: its seat.")
    inserted: str | None = Field(
        default=None, description="Trajectory at which an instrument is in the guide."
    )
    drill: tuple[str, float, bool] | None = Field(
        default=None, description="Drill in the assistant's holder: trajectory, tip beyond the clamp, turns."
    )
    hung_kg: float = Field(default=0.0, ge=0.0, description="Test weight on the assistant's holder.")
    opening: tuple[str, float, float] = Field(
        default=("", 0.0, 0.0),
        description="Opening drilled last: trajectory, bottom below the skin, tip beyond the skull.",
    )
    arm: SavedArm | None = Field(description="None until the robot has started.")
    assistant: SavedArm | None = Field(default=None, description="The second arm; None without one.")
    standing_faults: str = Field(
        default="", description="Script of the faults with lasting effects: what was moved, bent or turned."
    )

    @classmethod
    def from_world(cls, world: World) -> SavedWorld:
        """Capture the present state of a world."""
        return cls(
            theatre_time_ns=world.clock.now_ns(),
            mounted_tool=world.mounted_tool(),
            mountings=world.mountings(),
            inserted=world.inserted(),
            drill=world.held_drill(),
            hung_kg=world.hung_kg(),
            opening=world.opening(),
            arm=SavedArm.from_world(world, ArmRole.MASTER),
            assistant=SavedArm.from_world(world, ArmRole.ASSISTANT),
            standing_faults=standing_faults(world),
        )

    def restore(self, scene: Scene, *, paced: bool) -> World:
        """Create a world from this state and the given scene."""
        world = World.create(scene, paced=paced, begins_ns=self.theatre_time_ns)
        world.mount_tool(self.mounted_tool, self.mountings)
        world.put_in_guide(self.inserted)
        world.hold_drill(None if self.drill is None else DrillRow(*self.drill))
        world.hang_weight(self.hung_kg)
        world.note_opening(*self.opening)
        world.set_fault_script(self.standing_faults)
        for role, arm in ((ArmRole.MASTER, self.arm), (ArmRole.ASSISTANT, self.assistant)):
            if arm is not None:
                # The robot simulator publishes the flange's true pose before anyone can read it.
                world.publish_arm(
                    ArmState(arm.joints_rad, np.eye(4), arm.motion_number, True, arm.flanks, arm.moved_s),
                    role,
                )
        return world


def save_world(world: World, folder: Path) -> None:
    """Save a world's state atomically."""
    write_atomically(folder / WORLD_FILE, SavedWorld.from_world(world).model_dump_json(indent=1).encode())


def read_saved_world(folder: Path) -> SavedWorld:
    """Read the state saved in a folder; raises SIM-003, SIM-012 also where there is none."""
    path = folder / WORLD_FILE
    if not path.exists():
        raise BAD_SAVED_WORLD(f"{folder} has no {WORLD_FILE}", expected=EXPECTED)
    try:
        saved = SavedWorld.model_validate_json(read_json_bytes(path), strict=False)
    except ValidationError as error:
        raise BAD_SAVED_WORLD(
            f"{path} was changed", expected=EXPECTED, got="; ".join(describe_mistakes(error))
        ) from error
    parse_faults(saved.standing_faults)
    return saved


STANDING = (*(kind for kind in ROOM_FAULTS if kind not in (PUSH, PUSH_OVER)), TWIST, *DISPLACED_TOOLS)


def standing_faults(world: World) -> str:
    """Return a script reproducing fault displacements and bends, each with its remaining duration.

    They all begin at the present time, so their lines are in the order in which they began.
    """
    now_s = world.clock.now_s()
    lines = []
    for roll_mm in list_cart_rolls_mm(FaultBoard(world, ROOM), now_s):
        roll = " ".join(f"{value:.6f}" for value in roll_mm)
        lines.append(f"{format_beginning(now_s)}: {ROOM} shift {CART} {roll} mm")
    for device in sorted({kind.device for kind in STANDING}):
        for fault, onset_s in sorted(FaultBoard(world, device).acting_since(), key=itemgetter(1)):
            if fault.kind in STANDING:
                remaining_s = onset_s + fault.duration_s - now_s
                end = "" if math.isinf(remaining_s) else f" for {remaining_s:.6f} s"
                stands = finished(fault) if fault.kind is MOVE else come_to(fault, onset_s, now_s)
                for one in filter(None, (stands, still_to_come(fault, onset_s, now_s))):
                    lines.append(f"{format_beginning(now_s)}: {one.phrase}{end}")
    return "\n".join(lines)


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Lock a folder for one theatre; raises SIM-013 if another theatre using it does not end in time."""
    folder.mkdir(parents=True, exist_ok=True)
    file = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        limit_s = time.monotonic() + END_LIMIT_S
        while True:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() > limit_s:
                    raise THEATRE_RUNNING(
                        f"another theatre is running in {folder}",
                        action=f"Stop it with ronna-sim stop {folder}, or give another folder.",
                    ) from None
                time.sleep(RETRY_S)  # a file lock cannot be awaited with a time limit
        yield
    finally:
        os.close(file)
