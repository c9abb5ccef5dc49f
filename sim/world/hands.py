"""Manual work with guide and instrument, and its readings: `{"do": "work", ...}`.

Tasks are named as in the procedure. Work that affects only skin and skull has no effect here.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from difflib import get_close_matches
from math import isfinite, radians
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ronna_hw.wire.room_tasks import (
    CART_LOCK,
    CART_PLACE,
    CART_PUSH,
    DEPTH_STOP,
    DIALS,
    DRILL,
    DURA,
    GAUGE,
    HEAD_CLAMP,
    INSERT,
    OUT,
    SKIN,
    TOUCH,
)
from sim.world.faults import FaultBoard, begin_now
from sim.world.faults.room import CART, DEVICE, UNLOCKED, WRONG_STOP
from sim.world.noise import noise
from sim.world.rigid import Matrix, apply, inverse, matrix_of
from sim.world.room_shift import ShiftedRoom
from sim.world.stand import read_dials
from sim.world.true_guide import TrueGuide, calibrated_tip
from sim.world.truth import append_sample, sample_instrument
from sim.world.world import World

Readings = tuple[float, ...]
STOP, DIAL = "depth stop", "gauge"  # keys of the noise
SCALE_MM = 0.05  # divisions of the depth stop's scale: a vernier
DIAL_MM = 0.001  # of the gauge: a digital one
POINTER_MM = 2.0  # per axis, one standard deviation: where a person sets a pointer on skin


NUMBERS = {  # how many a task needs, and what they are; the others need none
    DEPTH_STOP: (1, "a length in mm"),
    GAUGE: (7, "the arm's six joints in deg and the height between the dials in mm"),
    TOUCH: (3, "a direction from the middle of the head: left, posterior, superior, as shares of its size"),
}


class WrongNumbers(Exception):
    """A task was given other numbers than it needs."""

    def __init__(self, task: str, got: Sequence[float]) -> None:
        _, needed = NUMBERS.get(task, (0, "no numbers"))
        given = ", ".join(f"{number:g}" for number in got) or "no numbers"
        super().__init__(f"{task} needs {needed}; got {given}")


class NoSuchTask(Exception):
    """The hands know no task with this name."""

    def __init__(self, task: str, known: Iterable[str]) -> None:
        near = get_close_matches(task, tuple(known), n=1)
        super().__init__(f"unknown task {task!r}; expected {', '.join(known)}")
        self.advice = f"Did you mean {near[0]}?" if near else "Use the task named in the question."


class NoTrajectory(Exception):
    """A task that is done at one trajectory was asked for without its name."""

    advice = "Add --trajectory with the name in the question, such as --trajectory T1."

    def __init__(self, task: str) -> None:
        super().__init__(f"{task} needs the name of a trajectory of the plan; got none")


class Hands:
    """One pair, for the life of a theatre. Truth at a target is stored in `folder`, if there is one."""

    def __init__(self, world: World, folder: Path | None) -> None:
        self._world = world
        self._folder = folder
        self._guide = TrueGuide(world)
        self._board = FaultBoard(world, DEVICE)
        self._stop_mm: float | None = None
        self._done: Counter[str] = Counter()  # how often each task was done, so that no two are alike

    def work(self, task: str, trajectory: str, numbers: Sequence[float]) -> Readings:
        """Carry out one task; raises NoSuchTask, NoTrajectory, WrongNumbers, or ValueError if it cannot
        be done.
        """
        nothing: Callable[[], Readings] = tuple
        tasks: dict[str, Callable[[], Readings]] = {
            DEPTH_STOP: lambda: self._set_stop(trajectory, float(numbers[0])),
            **dict.fromkeys((SKIN, DRILL, DURA, HEAD_CLAMP, CART_PLACE, CART_LOCK), nothing),
            CART_PUSH: self._push_cart,
            INSERT: lambda: self._insert(trajectory),
            OUT: nothing,
            DIALS: lambda: tuple(read_dials(self._world)),
            GAUGE: lambda: self._read_gauge(numbers),
            TOUCH: lambda: self._touch(numbers),
        }
        if task not in tasks:
            raise NoSuchTask(task, tasks)
        needed, _ = NUMBERS.get(task, (0, ""))
        if len(numbers) != needed or not all(map(isfinite, numbers)):
            raise WrongNumbers(task, numbers)
        if task == INSERT and not trajectory:
            raise NoTrajectory(task)
        readings = tasks[task]()
        self._done[f"{task} {trajectory}"] += 1
        return readings

    def _set_stop(self, trajectory: str, setting_mm: float) -> Readings:
        scene = self._world.scene
        again = self._done[f"{DEPTH_STOP} {trajectory}"]
        drawn = noise(scene.seed, f"{STOP} {trajectory}", again).normal(0.0, scene.mount.guide.depth_stop_mm)
        off_mm = sum(float(one.argument) for one in self._board.active(WRONG_STOP.name))
        self._stop_mm = setting_mm + float(drawn) + off_mm
        return (_on_scale(self._stop_mm, SCALE_MM),)

    def _insert(self, trajectory: str) -> Readings:
        if self._stop_mm is None:
            raise ValueError("no depth stop was set")
        again = self._done[f"{INSERT} {trajectory}"]
        sample = sample_instrument(self._world, self._guide, trajectory, self._stop_mm, again)
        if self._folder is not None:
            append_sample(sample, self._folder)
        return ()

    def _push_cart(self) -> Readings:
        """A locked cart stays; an unlocked one rolls, and stays there."""
        for fault in self._board.active(UNLOCKED.name):
            way = " ".join(fault.arguments)
            _, text = self._world.fault_script()
            rolled = begin_now(f"{DEVICE} shift {CART} {way} mm", self._world.clock.now_s())
            self._world.set_fault_script(f"{text}\n{rolled}")
        return ()

    def _read_gauge(self, numbers: Sequence[float]) -> Readings:
        """Dials at the mandrel's end along x, y and z, and higher up along x and y, mm.

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
        return tuple(_on_scale(float(value), DIAL_MM) for value in read)

    def _touch(self, direction: Sequence[float]) -> Readings:
        """Where the pointer is that touches the patient's head on that side, in the robot frame."""
        head, seed = self._world.scene.head, self._world.scene.seed
        skin_ct = np.array(head.centre_ct_mm) + np.array(head.semi_axes_mm) * direction
        place = apply(matrix_of(head.robot_from_ct), skin_ct) + ShiftedRoom(self._world).now().head_mm
        place += noise(seed, TOUCH, self._done[f"{TOUCH} "]).normal(0.0, POINTER_MM, 3)
        return tuple(_on_scale(float(value), 1.0) for value in place)

    def _place_of_gauge(self, joints_deg: Sequence[float]) -> Matrix:
        """Where the correct mandrel's end was, with the arm there, when the gauge was zeroed."""
        from sim.world.arm.true_arm import TrueArm

        arm = TrueArm(self._world.scene.arm, self._world.scene.seed)
        flange = arm.moving([radians(angle) for angle in joints_deg], (1.0,) * len(joints_deg))
        return flange @ calibrated_tip(self._world)


def _on_scale(value: float, step: float) -> float:
    return round(round(value / step) * step, 6)
