"""User strategies whose answers are checked: axes, poses at the spheres, turns."""

from __future__ import annotations

import inspect
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from procedures.strategies.errors import NoNearbyJoints
from procedures.strategies.strategy import ArmInBranch, Strategy
from procedures.strategies.trajectory import Trajectory
from ronna_hw.errors import LimitError
from ronna_hw.frames import Frame, Transform
from studies.errors import MethodAnswerWrong, MethodRefused
from studies.plugins.answers import call_plugin
from studies.plugins.method import PluginMethod

LARGEST_TURN_RAD = 2.0 * math.pi  # a whole turn: more means degrees
MOST_SHOWN = 10**6  # a whole number may be too large for a float
AT_SPHERE_MM = 1e-3  # between a sphere and the tool origin: rounding, far below any error of the study
OUT_OF_REACH = (LimitError, NoNearbyJoints)  # errors that a strategy may raise for a turn: the next is tried
FLAGS = ("localizes_per_trajectory", "controls_approach")
CALLS = ("localized_along", "localization_poses", "turns_rad")


@dataclass(frozen=True)
class PluginStrategy:
    """A `Strategy` that delegates to the user's; raises STU-012 to STU-014."""

    name: str
    user_strategy: Strategy

    @classmethod
    def of(cls, method: PluginMethod) -> Self:
        """Load the strategy into this process. Raises STU-012 and STU-013."""
        made = call_plugin(method.name, method.function())
        for flag in FLAGS:
            if not isinstance(value := call_plugin(f"{method.name}.{flag}", getattr, made, flag, None), bool):
                raise _missing_member_error(method.name, f"{flag}, True or False", f"{value!r}")
        for call in CALLS:
            member = call_plugin(f"{method.name}.{call}", getattr, made, call, None)
            parameter_names = list(inspect.signature(getattr(Strategy, call)).parameters)[1:]
            try:
                inspect.signature(member).bind(*parameter_names)  # None is also refused
            except (TypeError, ValueError) as error:
                raise _missing_member_error(
                    method.name, f"{call}({', '.join(parameter_names)})", f"{member!r}: {error}"
                ) from error
        return cls(method.name, made)

    @property
    def localizes_per_trajectory(self) -> bool:
        return self._read_flag("localizes_per_trajectory")

    @property
    def learns_arm(self) -> bool:
        """A researcher's strategy registers each target by its own looks."""
        return False

    @property
    def controls_approach(self) -> bool:
        return self._read_flag("controls_approach")

    def localized_along(
        self, trajectories: Sequence[Trajectory], fiducials_mm: ArrayLike, robot_from_ct: Transform
    ) -> tuple[Trajectory, ...]:
        """Return one axis for each set of localizations."""
        axes = self._call("localized_along", trajectories, fiducials_mm, robot_from_ct)
        parameter_names = len(trajectories) if self.localizes_per_trajectory else 1
        if len(axes) != parameter_names or not all(isinstance(one, Trajectory) for one in axes):
            raise self._wrong_answer("localized_along", f"{parameter_names} Trajectory", _format_answer(axes))
        return axes

    def localization_poses(
        self, along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
    ) -> tuple[Transform, ...]:
        """Return one pose ROBOT <- TOOL per fiducial, with the tool origin at the fiducial."""
        poses = self._call("localization_poses", along, fiducials_mm, robot_from_ct, arm)
        places = robot_from_ct.apply(np.reshape(fiducials_mm, (-1, 3)))
        framed = all(
            isinstance(one, Transform) and (one.target, one.source) == (Frame.ROBOT, Frame.TOOL)
            for one in poses
        )
        if len(poses) != len(places) or not framed:
            raise self._wrong_answer(
                "localization_poses", f"{len(places)} Transform ROBOT <- TOOL", _format_answer(poses)
            )
        off_mm = max(
            float(np.linalg.norm(one.translation_mm - at)) for one, at in zip(poses, places, strict=True)
        )
        if off_mm > AT_SPHERE_MM:
            raise self._wrong_answer(
                "localization_poses", "the tool's origin at each fiducial", f"{off_mm:.3g} mm off"
            )
        return poses

    def turns_rad(
        self, along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
    ) -> Sequence[float]:
        """Return turns about the axis in rad, best first."""
        turns = self._call("turns_rad", along, fiducials_mm, robot_from_ct, arm)
        if not turns or not all(isinstance(one, int | float) for one in turns):
            raise self._wrong_answer("turns_rad", "at least one finite angle in rad", _format_answer(turns))
        for turn in turns:
            if not abs(turn) <= LARGEST_TURN_RAD:  # also rejects NaN
                shown = f"{turn:g}: degrees?" if abs(turn) < MOST_SHOWN else "a huge number"
                raise self._wrong_answer("turns_rad", "angles within ±2π rad", shown)
        return turns

    def _read_flag(self, flag: str) -> bool:
        """Read a boolean property once, since the user's class may recompute it on each access."""
        value = call_plugin(f"{self.name}.{flag}", getattr, self.user_strategy, flag)
        if not isinstance(value, bool):
            raise self._wrong_answer(flag, "True or False", f"{value!r}")
        return value

    def _call(self, call: str, *arguments: object) -> tuple[Any, ...]:
        answer = call_plugin(
            f"{self.name}.{call}", getattr(self.user_strategy, call), *arguments, passed=OUT_OF_REACH
        )
        if not isinstance(answer, Iterable):
            raise self._wrong_answer(call, "a sequence", type(answer).__name__)
        return tuple(call_plugin(f"{self.name}.{call}", list, answer))  # a generator runs only here

    def _wrong_answer(self, call: str, expected: str, got: str) -> MethodAnswerWrong:
        return MethodAnswerWrong(f"{self.name}.{call} returned a wrong result", expected=expected, got=got)


def _missing_member_error(name: str, expected: str, got: str) -> MethodRefused:
    return MethodRefused(f"{name} does not make a strategy", expected=expected, got=got)


def _format_answer(answer: Sequence[object]) -> str:
    kinds = ", ".join(sorted({type(one).__name__ for one in answer})) or "nothing"
    return f"{len(answer)} of {kinds}" if answer else "none"
