"""A room with two arms of one kind, localized, as the tracker sees it without noise."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from remembering_arm import RememberingArm
from room_looks import room_reading_of, seen_frame
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.guards.room_reading import CAREFUL_FRAMES, RoomReading
from procedures.guards.room_watch import RoomLook, RoomWatch
from procedures.room.motion import RoomMotion
from procedures.room.sighting import Rest, Tracked
from procedures.steps.clinical.localized_room import LocalizedRoom
from procedures.strategies.strategy import ONE_SIDE
from procedures.workcell import Workcell
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.error_budget import ErrorSizes
from ronna_hw.devices.readings import Validity
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import JointVector, joint_vector

KR6 = kr6_r900()
HOME_RAD = joint_vector(map(math.radians, (0.0, -110.0, 120.0, 0.0, 60.0, 0.0)))
OVER_GUIDE_RAD = joint_vector(map(math.radians, (10.0, -75.0, 95.0, 10.0, 70.0, -20.0)))
TURNS = ((0.0, 0.0), (12.0, 20.0), (-12.0, -20.0), (12.0, -20.0), (-12.0, 20.0), (6.0, 40.0), (-6.0, -40.0))
MARKERS_MM = np.array([[0.0, 0.0, 0.0], [60.0, 0.0, 0.0], [0.0, 80.0, 0.0], [-50.0, -40.0, 0.0]])
MOUNT = Transform.of(Frame.FLANGE, Frame.MARKER, translation_mm=(60.0, 0.0, 40.0))
TO_ROBOT = Transform.of(Frame.ROBOT, Frame.TRACKER, translation_mm=(700.0, -1500.0, 900.0))
BASE = Transform.of(
    Frame.ROBOT, Frame.ASSISTANT, translation_mm=(1400.0, 0.0, 0.0), quaternion_wxyz=(0.0, 0.0, 0.0, 1.0)
)
SPHERES_MM = np.array(
    [[700.0, 0.0, 300.0], [760.0, 40.0, 320.0], [660.0, 60.0, 340.0], [710.0, -60.0, 350.0]]
)
TARGET_MM = np.array([700.0, 0.0, 260.0])
ARM = RememberingArm(KR6.chain, ErrorSizes(), MOUNT.as_matrix(), 0.03)
ASSISTING_ARM = replace(ARM, robot_from_base=BASE.as_matrix())
STILL = RigidTransform.identity()
BORE = SimpleNamespace(reach_mm=40.0, length_mm=80.0)


def shifted(*way_mm: float) -> RigidTransform:
    return RigidTransform.from_translation(way_mm)


def turned_about(place_mm: Array, degrees: float) -> RigidTransform:
    turn = RigidTransform.from_rotation(Rotation.from_rotvec((0.0, 0.0, math.radians(degrees))))
    return shifted(*place_mm) * turn * shifted(*-place_mm)


def flange_of_assistant(joints_rad: JointVector, _sides: object = None) -> Transform:
    flange = KR6.flange_pose(joints_rad)
    return BASE @ Transform(Frame.ASSISTANT, Frame.FLANGE, flange.rigid)


class TwoArmRoom:
    """Localized with both arms home; the looks at the assistant's turned frame follow if `known`."""

    def __init__(self, *, known: bool = True) -> None:
        room = LocalizedRoom(
            TO_ROBOT, TO_ROBOT.inverse().apply(SPHERES_MM), HOME_RAD, MARKERS_MM, CAREFUL_FRAMES
        )
        self.watch: RoomWatch = room.watch("room", ARM, lambda joints, _sides: KR6.flange_pose(joints))
        self.watch.points_mm = {"T1": TARGET_MM}
        self.joints_rad = HOME_RAD
        if known:
            self.turn_frame()
            assert self.take_in() is None

    def turn_frame(self, carts: RigidTransform = STILL) -> None:
        """Look with the assistant's frame turned at the head and then home, its cart displaced meanwhile."""
        for number, (first, last) in enumerate(TURNS):
            one, two, three, four, five, six = OVER_GUIDE_RAD
            turned = (one, two, three, four + math.radians(first), five, six + math.radians(last))
            self.look(joint_vector(turned), assistant=carts if number > 2 else STILL)
        self.look(HOME_RAD, assistant=carts)

    def take_in(self, first_look: int = 0) -> RoomMotion | None:
        return self.watch.take_in_assistant("bases", ASSISTING_ARM, flange_of_assistant, first_look)

    def reading(
        self,
        joints_rad: JointVector | None = None,
        *,
        assistant: RigidTransform = STILL,
        master: RigidTransform = STILL,
        head: RigidTransform = STILL,
        hidden: bool = False,
        guide_hidden: bool = False,
        led: bool = False,
    ) -> RoomReading:
        """A careful reading with the carts and the head displaced so far, robot frame.

        `hidden` is the assistant's frame, `guide_hidden` that of the arm with the guide.
        """
        joints_rad = joints_rad or self.joints_rad
        to_tracker = TO_ROBOT.inverse().rigid
        on_arm = to_tracker * master * (KR6.flange_pose(HOME_RAD) @ MOUNT).rigid
        on_assistant = to_tracker * assistant * (flange_of_assistant(joints_rad) @ MOUNT).rigid
        spheres_mm = (to_tracker * head).apply(SPHERES_MM)
        seen = room_reading_of(
            KR6.flange_pose(HOME_RAD),
            HOME_RAD,
            spheres_mm,
            CAREFUL_FRAMES,
            sides=ONE_SIDE,
            arm=seen_frame(on_arm.as_matrix(), MARKERS_MM, CAREFUL_FRAMES),
        )
        frame = seen_frame(on_assistant.as_matrix(), MARKERS_MM, CAREFUL_FRAMES)
        frames = seen.frames if hidden else {**seen.frames, Tracked.ASSISTANT: frame}
        if guide_hidden:
            frames = {name: one for name, one in frames.items() if name is not Tracked.ARM}
        rests = {**seen.rests, Tracked.ASSISTANT: Rest(joints_rad, ONE_SIDE)}
        return replace(seen, frames=frames, rests=rests, instrument_led=led)

    def look(self, joints_rad: JointVector | None = None, **room: Any) -> RoomLook:
        self.joints_rad = joints_rad or self.joints_rad
        return self.watch.compare(self.reading(**room))

    @property
    def frame_mm(self) -> Array:
        """Place (3,) mm of the assistant's frame, robot frame."""
        return (flange_of_assistant(self.joints_rad) @ MOUNT).translation_mm

    def workcell(self, cart: list[RigidTransform] | None = None) -> Workcell:
        """A workcell whose guide is over the target, upright, and whose assistant is on the axis."""
        pose = Transform.of(
            Frame.ROBOT,
            Frame.TOOL,
            translation_mm=tuple(TARGET_MM.tolist()),
            quaternion_wxyz=(0.0, 1.0, 0.0, 0.0),
        )
        assistant = SimpleNamespace(
            holder=SimpleNamespace(frame="assistant_frame"),
            place=SimpleNamespace(
                axis=SimpleNamespace(trajectory="T1", travel_mm=200.0), is_on_axis=True, is_out=True
            ),
            arm=SimpleNamespace(
                observe=lambda: SimpleNamespace(reading=SimpleNamespace(joints_rad=self.joints_rad))
            ),
        )
        fields = {
            "assistant": assistant,
            "assistants": (assistant,),
            "tools": SimpleNamespace(guide=SimpleNamespace(bore=BORE)),
            "master": SimpleNamespace(tool_pose=lambda: pose),
            "tracker": SimpleNamespace(markers_mm={"assistant_frame": MARKERS_MM}),
        }
        return cast("Workcell", SimpleNamespace(**fields))

    def frame(self, assistant: RigidTransform = STILL, *, hidden: bool = False) -> Any:
        """One tracker frame of the assistant."""
        pose = TO_ROBOT.inverse().rigid * assistant * (flange_of_assistant(self.joints_rad) @ MOUNT).rigid
        seen = Transform(Frame.TRACKER, Frame.MARKER, pose)
        validity = Validity.MISSING if hidden else Validity.OK
        one = SimpleNamespace(validity=validity, transform=lambda _target, _source: seen)
        return SimpleNamespace(tool=lambda _name: one)
