"""Simulated theatre staff: manual tasks with guide, instrument, stand and gauge, and their readings.

Tasks are named as in the procedure. Work on skin and skull by hand has no effect here. The calibration stand
on the table holds a removable ball or a divot with three dials: staff raise the divot to the tip of a guide
and read its offset from the position of the ball's centre, along the stand's own axes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from math import isfinite, radians
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ronna_hw.near_names import find_near
from ronna_hw.wire.room_tasks import (
    CART_LOCK,
    CART_PLACE,
    CART_PUSH,
    DEPTH_STOP,
    DIALS,
    DRILL,
    DRILL_HOLDER,
    DURA,
    EMPTY,
    GAUGE,
    HEAD_CLAMP,
    HOLDER,
    INSERT,
    MEASURE,
    OUT,
    REST_DRILL,
    SCAN,
    SEATED,
    SITE_MARK,
    SKIN,
    TEST_WEIGHT,
    TOUCH,
    TURN_DRILL,
    OnStand,
)
from sim.errors import STAND_NOT_READY
from sim.world.displacements import ShiftedRoom, rigid_move
from sim.world.faults import FaultBoard, begin_now
from sim.world.faults.room import CART, DEVICE, UNLOCKED, WRONG_STOP, tool_numbers
from sim.world.noise import noise
from sim.world.rigid import Matrix, Vector, apply, as_point, inverse, matrix_of, rotation_from_vector
from sim.world.scene.skin import find_furthest
from sim.world.truth import (
    TrueGuide,
    append_sample,
    sample_instrument,
    sample_seated_instrument,
    tip_at_calibration,
)
from sim.world.world import DrillRow, World

Readings = tuple[float, ...]

STOP, DRILL_STOP, DIAL = "depth stop", "stop of the drill", "gauge"  # noise keys
SCALE_MM = 0.05  # graduation of the depth stop: a vernier
DIAL_MM = 0.001  # resolution of the digital gauge
LARGEST_WEIGHT_KG = 3.0  # among the test weights of the room: what a small arm may carry
POINTER_MM = 2.0  # one standard deviation per axis of a pointer set on skin by hand
TAPE_MM = 10.0  # the same of a place measured by a tape from the base of the arm

THROUGH_THE_GUIDE = (SKIN, DRILL, DURA, INSERT, SEATED)
NUMBERS = {  # count and meaning of the numbers that a task needs; other tasks need none
    DEPTH_STOP: (1, "a length in mm"),
    DRILL_HOLDER: (1, "a length in mm"),
    TEST_WEIGHT: (1, "a mass in kg, 0 to take it off"),
    GAUGE: (7, "the arm's six joints in deg and the height between the dials in mm"),
    **dict.fromkeys(
        (TOUCH, MEASURE),
        (3, "a direction from the middle of the head: left, posterior, superior, as shares of its size"),
    ),
}


class TaskRefused(Exception):
    """The task cannot be carried out as requested; `advice` is the remedy."""

    def __init__(self, reason: str, advice: str) -> None:
        super().__init__(reason)
        self.advice = advice


class Staff:
    """Theatre staff who carry out tasks, recording the truth at each target in `folder` if given."""

    def __init__(self, world: World, folder: Path | None) -> None:
        self._world = world
        self._folder = folder
        self._guide = TrueGuide(world)
        self._board = FaultBoard(world, DEVICE)
        self._stop_mm: float | None = None
        self._stop_for = ""  # the trajectory for which the depth stop was set
        self._done: Counter[str] = Counter()  # tasks done so far: repetitions draw other noise

    def work(self, task: str, trajectory: str, numbers: Sequence[float]) -> Readings:
        """Carry out a task and return its readings.

        Raises TaskRefused, SIM-015, or ValueError if it cannot be done.
        """
        nothing: Callable[[], Readings] = tuple
        tasks: dict[str, Callable[[], Readings]] = {
            DEPTH_STOP: lambda: self._set_stop(trajectory, float(numbers[0])),
            **dict.fromkeys((SKIN, DRILL, DURA, HEAD_CLAMP, SCAN, CART_PLACE, CART_LOCK), nothing),
            CART_PUSH: self._push_cart,
            INSERT: lambda: self._insert(trajectory),
            **dict.fromkeys((HOLDER, EMPTY), self._empty_holder),
            TEST_WEIGHT: lambda: self._hang_weight(float(numbers[0])),
            DRILL_HOLDER: lambda: self._hold_drill(trajectory, float(numbers[0])),
            TURN_DRILL: lambda: self._switch_drill(turns=True),
            REST_DRILL: lambda: self._switch_drill(turns=False),
            SEATED: lambda: self._look_at_stop(trajectory),
            OUT: self._take_out,
            DIALS: lambda: tuple(read_dials(self._world)),
            GAUGE: lambda: self._read_gauge(numbers),
            TOUCH: lambda: self._read_place(self._find_furthest(numbers), TOUCH, POINTER_MM),
            MEASURE: lambda: self._read_place(self._find_furthest(numbers), MEASURE, TAPE_MM),
            SITE_MARK: lambda: self._read_place(self._find_site(trajectory), SITE_MARK, POINTER_MM),
        }
        _check_task(task, trajectory, numbers, tasks)
        if task in THROUGH_THE_GUIDE:
            self._require_guide(task)
        readings = tasks[task]()
        self._done[f"{task} {trajectory}"] += 1
        return readings

    def _require_guide(self, task: str) -> None:
        """Raise TaskRefused unless a guide is mounted: nothing else has a bore to work through."""
        none, head, guide = tool_numbers(self._world.scene)
        if (mounted := self._world.mounted_tool()) in (none, head):
            raise TaskRefused(
                f"{task} is done through the guide, tool {guide}; mounted is "
                f"{'no tool' if mounted == none else f'the stereo head, tool {head}'}",
                f"Mount the guide first: ronna-sim mount {guide}.",
            )

    def _set_stop(self, trajectory: str, setting_mm: float) -> Readings:
        scene = self._world.scene
        again = self._done[f"{DEPTH_STOP} {trajectory}"]
        drawn = noise(scene.seed, f"{STOP} {trajectory}", again).normal(0.0, scene.mount.guide.depth_stop_mm)
        off_mm = sum(float(one.argument) for one in self._board.active(WRONG_STOP.name))
        self._stop_mm, self._stop_for = setting_mm + float(drawn) + off_mm, trajectory
        return (_round_to_scale(self._stop_mm, SCALE_MM),)

    def _insert(self, trajectory: str) -> Readings:
        if self._stop_mm is None:
            raise ValueError("no depth stop was set")
        if self._stop_for not in ("", trajectory):
            raise TaskRefused(
                f"the depth stop was set for {self._stop_for}; got an order to insert at {trajectory}",
                f"Name the trajectory in the question, or set the depth stop for {trajectory} first.",
            )
        again = self._done[f"{INSERT} {trajectory}"]
        sample = sample_instrument(self._world, self._guide, trajectory, self._stop_mm, again)
        if self._folder is not None:
            append_sample(sample, self._folder)
        self._world.put_in_guide(trajectory)
        return ()

    def _look_at_stop(self, trajectory: str) -> Readings:
        """Look whether the stop of an instrument that the assistant has inserted rests on the guide."""
        if self._stop_mm is None or self._stop_for not in ("", trajectory):
            raise ValueError(f"no depth stop was set for {trajectory}")
        sample, gap_mm = sample_seated_instrument(self._world, self._guide, trajectory, self._stop_mm)
        if self._folder is not None:
            append_sample(sample, self._folder)
        self._world.put_in_guide(trajectory)
        return (_round_to_scale(gap_mm, SCALE_MM),)

    def _take_out(self) -> Readings:
        self._world.put_in_guide(None)
        return self._empty_holder()

    def _empty_holder(self) -> Readings:
        """Take the drill, if it is there, out of the assistant's holder."""
        self._world.hold_drill(None)
        return ()

    def _hang_weight(self, mass_kg: float) -> Readings:
        if not 0.0 <= mass_kg <= LARGEST_WEIGHT_KG:
            raise TaskRefused(
                f"there is no test weight of {mass_kg:g} kg", f"Use one of at most {LARGEST_WEIGHT_KG:g} kg."
            )
        self._world.hang_weight(mass_kg)
        return ()

    def _hold_drill(self, trajectory: str, setting_mm: float) -> Readings:
        """Set the stop of the drill as that of an instrument, and put it into the assistant's holder."""
        drawn = noise(self._world.scene.seed, f"{DRILL_STOP} {trajectory}", 0).normal(
            0.0, self._world.scene.mount.guide.depth_stop_mm
        )
        self._world.hold_drill(DrillRow(trajectory, setting_mm + float(drawn), turns=False))
        return (_round_to_scale(setting_mm + float(drawn), SCALE_MM),)

    def _switch_drill(self, *, turns: bool) -> Readings:
        drill = self._world.held_drill()
        if drill is None:
            raise TaskRefused("no drill is in the assistant's holder", "Put it there first.")
        self._world.hold_drill(drill._replace(turns=turns))
        return ()

    def _push_cart(self) -> Readings:
        """Push the cart, which rolls away permanently if unlocked."""
        for fault in self._board.active(UNLOCKED.name):
            displacement = " ".join(fault.arguments)
            _, text = self._world.fault_script()
            rolled = begin_now(f"{DEVICE} shift {CART} {displacement} mm", self._world.clock.now_s())
            self._world.set_fault_script(f"{text}\n{rolled}")
        return ()

    def _read_gauge(self, numbers: Sequence[float]) -> Readings:
        """Read the dials in mm: at the mandrel's end along x, y and z, and higher up along x and y.

        `numbers` are the arm's joints in deg at the gauge, and the height between the dials.
        """
        *joints_deg, base_mm = numbers
        seen = inverse(self._place_of_gauge(joints_deg)) @ self._guide.mandrel()
        higher: NDArray[np.float64] = (seen @ np.array([0.0, 0.0, -base_mm, 1.0]))[:3]
        there = np.array([*seen[:3, 3], *higher[:2]])
        scene = self._world.scene
        read = there + noise(scene.seed, DIAL, self._done[f"{GAUGE} "]).normal(
            0.0, scene.hands.gauge_mm, len(there)
        )
        return tuple(_round_to_scale(float(value), DIAL_MM) for value in read)

    def _find_furthest(self, direction: Sequence[float]) -> Vector:
        """Return where the patient's head reaches furthest in a direction."""
        return find_furthest(self._world.scene.head, np.array(direction))

    def _find_site(self, trajectory: str) -> Vector:
        """Return the entry of a trajectory of the scene, which the surgeon has marked on the patient."""
        entries = {one.identifier: one.entry_ct_mm for one in self._world.scene.head.targets}
        if trajectory not in entries:
            raise TaskRefused(
                f"no site is marked for {trajectory or 'no trajectory'} on the simulated patient",
                f"Name one of the scene's: {', '.join(entries)}.",
            )
        return np.array(entries[trajectory])

    def _read_place(self, skin_ct_mm: Vector, task: str, error_mm: float) -> Readings:
        """Return where a person reads a place of the patient's head, given in the CT, in the robot frame."""
        head, seed = self._world.scene.head, self._world.scene.seed
        room = ShiftedRoom(self._world).now()
        place = apply(rigid_move(room.head_rad, room.head_mm) @ matrix_of(head.robot_from_ct), skin_ct_mm)
        place += noise(seed, task, self._done[f"{task} "]).normal(0.0, error_mm, 3)
        return tuple(_round_to_scale(float(value), 1.0) for value in place)

    def _place_of_gauge(self, joints_deg: Sequence[float]) -> Matrix:
        """Return the pose of the calibrated mandrel's end where the gauge was zeroed."""
        from sim.world.true_arm import TrueArm

        arm = TrueArm(self._world.scene.arm, self._world.scene.seed)
        flange = arm.moving([radians(angle) for angle in joints_deg], (1.0,) * len(joints_deg))
        return flange @ tip_at_calibration(self._world)


def read_dials(world: World) -> tuple[float, float, float]:
    """Read the three dials in mm with the divot raised to the guide's tip; raises SIM-015 if impossible."""
    stand, mount = world.scene.stand, world.scene.mount
    if (there := world.on_stand()) is not OnStand.DIVOT:
        holds = "nothing" if there is OnStand.NOTHING else f"the {there}"
        raise STAND_NOT_READY(f"the divot is not on the stand, which holds {holds}")
    if world.mounted_tool() != mount.tool_number_guide:
        raise STAND_NOT_READY("the guide is not mounted", got=f"tool {world.mounted_tool()}")
    zero = np.add(stand.ball_mm, stand.divot_from_ball_mm)
    away = rotation_from_vector(stand.dials_turned_rad).T @ (TrueGuide(world).mandrel()[:3, 3] - zero)
    if np.abs(away).max() > stand.travel_mm:
        raise STAND_NOT_READY(
            "the tip is beyond the divot's travel",
            limit=f"{stand.travel_mm:g} mm along each axis",
            got=f"{np.abs(away).max():.1f} mm",
        )
    generator = noise(world.scene.seed, "dials", world.arm().motion_number)
    read = away + generator.normal(0.0, stand.reading_mm, 3)
    return as_point(round(value / stand.scale_mm) * stand.scale_mm for value in read.tolist())


def _check_task(task: str, trajectory: str, numbers: Sequence[float], known: Iterable[str]) -> None:
    if task not in known:
        near = find_near(task, known)
        raise TaskRefused(
            f"unknown task {task!r}; expected {', '.join(known)}",
            f"Did you mean {near[0]}?" if near else "Use the task named in the question.",
        )
    count, needed = NUMBERS.get(task, (0, "no numbers"))
    if len(numbers) != count or not all(map(isfinite, numbers)):
        given = ", ".join(f"{number:g}" for number in numbers) or "no numbers"
        raise TaskRefused(f"{task} needs {needed}; got {given}", "Give the numbers as in the question.")
    if task in (INSERT, SEATED, DRILL_HOLDER) and not trajectory:
        raise TaskRefused(
            f"{task} needs the name of a trajectory of the plan; got none",
            "Add --trajectory with the name in the question, such as --trajectory T1.",
        )


def _round_to_scale(value: float, step: float) -> float:
    return round(round(value / step) * step, 6)
