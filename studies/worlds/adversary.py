"""Adversarial worlds: one body or two are moved as the looks show least and the target feels most.

A world depends only on the seed and its number, so that every one can be repeated alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ronna_hw.arm.catalogue import ArmChoice
from sim.world.options import Carrier
from sim.world.process import load_scene
from sim.world.rigid import Matrix, apply, inverse, vector_from_rotation
from sim.world.scene.model import Scene
from studies.worlds.looks import ARM_MM, TWIST, HiddenMove, Looks, MovedBody, find_hidden_moves
from studies.worlds.world import MINI, fault_script

DEFAULT, EVERY_THIRD = "default", 3  # of the cases, one in three is in the default scene
ANY_MARKERS, X_FRAME_MARKERS = range(3, 9), 4
MOST_TARGETS = {MINI: 2, DEFAULT: 3}
FEW_MARKERS, FEW_SHARE = (3, 4), 0.5  # the fewer spheres, the less a look shows of the head
DUAL_SHARE, CALIBRATED_SHARE, X_FRAME_SHARE = 0.25, 0.5, 0.2
KILLED_SHARE, SLOW_SHARE = 0.25, 0.4
# An arm without a calibration is not expected to keep the margin of every plan in the neutral orientation.
STRATEGIES = ("ocs", "thesis-ocs", "jdms", "improved", "best")
CALIBRATED_STRATEGIES = (*STRATEGIES, "nos")
LEAST_SIGMAS, MOST_SIGMAS = 0.5, 3.0
LEAST_EFFECT_MM, MOST_EFFECT_MM = 0.1, 8.0  # at the target: less cannot be judged, more is no small change
DIRECTIONS = (0.7, 0.3)  # how often the worst and the second direction are drawn
# Bodies are drawn in proportion to the largest effect that the looks leave them, within these bounds.
GRAVE_MM, FAINT_MM = 0.6, 0.06
PUSH_MM, PUSH_DEG = 2.0, 0.2  # of a tracker, which no target feels
SLOWLY_S, LEANING_S, HELD_S = (5.0, 60.0), (1.0, 5.0), (3.0, 20.0)
KILLED_AFTER_S = (0.5, 10.0)  # theatre time from the change to the kill

RELOCALIZATION, TOOL_CHANGE, TOOL_CHECK = "relocalization", "tool_change", "tool_check"
POSITIONING, AT_TARGET, RETREAT = "positioning", "at_target", "retreat"
# About how long each step takes in theatre time; with two arms the assistant is at work at the target.
STEPS_S = {
    RELOCALIZATION: 18.0,
    TOOL_CHANGE: 2.5,
    TOOL_CHECK: 6.0,
    POSITIONING: 6.0,
    AT_TARGET: 3.0,
    RETREAT: 2.5,
}
AT_TARGET_DUAL_S = 50.0
OF_ALL = (TOOL_CHANGE, TOOL_CHECK)
STEPS_OF = {  # in which these bodies move; one for each time that it is to be drawn
    MovedBody.GUIDE: (POSITIONING, AT_TARGET),
    MovedBody.SEAT: (TOOL_CHECK, POSITIONING, AT_TARGET, RETREAT),
    MovedBody.ASSISTANT_CART: (TOOL_CHECK, POSITIONING, AT_TARGET, AT_TARGET),
}
SINGLE = ((MovedBody.HEAD,), (MovedBody.CART,), (MovedBody.SEAT,), (MovedBody.GUIDE,), (MovedBody.TRACKER,))
PAIRS = (
    (MovedBody.HEAD, MovedBody.CART),
    (MovedBody.CART, MovedBody.TRACKER),
    (MovedBody.HEAD, MovedBody.TRACKER),
)
OF_DUAL = (
    (MovedBody.ASSISTANT_CART,),
    (MovedBody.ASSISTANT_CART, MovedBody.TRACKER),
    (MovedBody.CART, MovedBody.ASSISTANT_CART),
)
SHARES: dict[tuple[MovedBody, ...], float] = {  # where they could do as much; one for each of the others
    (MovedBody.HEAD,): 4.0,
    (MovedBody.CART,): 3.0,
    (MovedBody.GUIDE,): 2.0,
    (MovedBody.ASSISTANT_CART,): 4.0,
}
One = TypeVar("One")


@dataclass(frozen=True)
class HiddenChange:
    """A change that the looks hardly show, and when it begins. `lines` are those of a fault script."""

    bodies: tuple[str, ...]
    step: str
    after_s: float  # since that step first began
    lines: tuple[str, ...]
    sigmas: float
    effect_mm: float

    @property
    def script(self) -> str:
        return fault_script(self.step, self.after_s, self.lines)

    @property
    def words(self) -> str:
        return f"{'+'.join(self.bodies)} at {self.step} + {self.after_s:.1f} s"


@dataclass(frozen=True)
class AdversarialWorld:
    """A case: its scene, arms and strategy, the change during it, and the kill after it, if any.

    `killed_after_s` is the theatre time from the change to the kill of the program.
    """

    seed: int  # of the campaign
    number: int
    scene: str
    scene_seed: int
    markers: int
    fiducials: Carrier
    targets: int
    strategy: str
    arm: ArmChoice
    assistant_arm: ArmChoice | None  # with two arms
    calibrated: bool
    change: HiddenChange
    killed_after_s: float | None

    @property
    def arguments(self) -> list[str]:
        """Options of `ronna-procedure run` for the case, without its fault script."""
        options = ["--sim", "--scene", self.scene, "--seed", str(self.scene_seed), "--arm", self.arm.value]
        options += ["--targets", str(self.targets), "--strategy", self.strategy]
        if self.fiducials is Carrier.XFRAME:
            options += ["--fiducials", self.fiducials.value]
        else:
            options += ["--markers", str(self.markers)]
        if self.assistant_arm is not None:
            options += ["--dual", "--assistant-arm", self.assistant_arm.value]
        return options + ["--calibrated"] * self.calibrated


class Adversary:
    """Draws one world."""

    def __init__(self, seed: int, number: int) -> None:
        self._seed, self._number = seed, number
        self._draws = np.random.default_rng(np.random.SeedSequence([seed, number]))

    def draw(self) -> AdversarialWorld:
        """Draw scene, arms, change and kill; only once."""
        scene = DEFAULT if self._number % EVERY_THIRD == EVERY_THIRD - 1 else MINI
        scene_seed = int(self._draws.integers(0, 10_000))
        on_frame = self._happens(X_FRAME_SHARE)
        markers = self._pick(FEW_MARKERS if self._happens(FEW_SHARE) else ANY_MARKERS)
        markers = X_FRAME_MARKERS if on_frame else markers
        targets = int(self._draws.integers(1, MOST_TARGETS[scene] + 1))
        arm, assistant_arm = self._pick(tuple(ArmChoice)), self._pick(tuple(ArmChoice))
        several = self._happens(DUAL_SHARE)
        calibrated = self._happens(CALIBRATED_SHARE)
        strategy = self._pick(CALIBRATED_STRATEGIES if calibrated or several else STRATEGIES)
        truth = load_scene(
            scene,
            seed=scene_seed,
            markers=markers,
            targets=targets,
            fiducials=Carrier.XFRAME if on_frame else Carrier.FREE,
            arm=arm,
            dual=several,
            assistant_arm=assistant_arm,
        )
        change = self._draw_change(truth, once=strategy == "nos")
        killed_after_s = self._between(KILLED_AFTER_S) if self._happens(KILLED_SHARE) else None
        return AdversarialWorld(
            self._seed,
            self._number,
            scene,
            scene_seed,
            markers,
            Carrier.XFRAME if on_frame else Carrier.FREE,
            targets,
            strategy,
            arm,
            assistant_arm if several else None,
            calibrated,
            change,
            killed_after_s,
        )

    def _draw_change(self, scene: Scene, *, once: bool) -> HiddenChange:
        several = len(scene.arms) > 1
        targets = scene.head.targets
        number = int(self._draws.integers(len(targets)))
        looks = Looks(scene, number)
        bodies = self._pick_bodies(looks, [*SINGLE, *PAIRS, *(OF_DUAL if several else ())])
        kind, at = self._pick_step(bodies), number
        if kind == RETREAT:  # felt at the next target; there is none after the last
            kind, at = (RETREAT, number - 1) if number else (AT_TARGET, number)
        target = targets[at].identifier
        shared = kind in OF_ALL or (once and kind == RELOCALIZATION)
        step = kind if shared else f"{kind}:{target}"
        takes_s = AT_TARGET_DUAL_S if several and kind == AT_TARGET else STEPS_S[kind]
        after_s = round(self._between((0.0, takes_s)), 3)
        move = self._draw_move(looks, bodies)
        ending = self._draw_ending(bodies)
        lines = [
            line
            for body, twist_mm in zip(move.bodies, move.twist_mm.reshape(-1, TWIST), strict=True)
            for line in format_lines(looks, body, looks.displacement(body, twist_mm), ending)
        ]
        if MovedBody.TRACKER in bodies:
            lines += self._draw_push(looks, ending)
        return HiddenChange(
            tuple(one.value for one in bodies), step, after_s, tuple(lines), move.sigmas, move.effect_mm
        )

    def _pick_bodies(self, looks: Looks, choices: Sequence[tuple[MovedBody, ...]]) -> tuple[MovedBody, ...]:
        weights = np.array([SHARES.get(one, 1.0) * _find_reach_mm(looks, one) for one in choices])
        return choices[int(self._draws.choice(len(choices), p=weights / weights.sum()))]

    def _pick_step(self, bodies: tuple[MovedBody, ...]) -> str:
        """Pick the step of a change: of the guide once it is mounted, by a hand once it is at the head."""
        own = (STEPS_OF[body] for body in bodies if body in STEPS_OF)
        return self._pick(next(own, tuple(STEPS_S)))

    def _draw_move(self, looks: Looks, bodies: tuple[MovedBody, ...]) -> HiddenMove:
        """Draw a direction and a size within the limits; a tracker alone has no move that is felt."""
        if bodies == (MovedBody.TRACKER,):
            return HiddenMove((), np.zeros(0), 0.0, 0.0)
        worst = find_hidden_moves(looks, bodies)[: len(DIRECTIONS)]
        one = worst[int(self._draws.choice(len(worst), p=DIRECTIONS))]
        wanted = self._between((LEAST_SIGMAS, MOST_SIGMAS))
        sigmas = min(max(wanted, LEAST_EFFECT_MM / one.effect_mm), MOST_EFFECT_MM / one.effect_mm)
        sign = 1.0 if self._happens(0.5) else -1.0
        return HiddenMove(one.bodies, sign * sigmas * one.twist_mm, sigmas, sigmas * one.effect_mm)

    def _draw_push(self, looks: Looks, ending: str) -> list[str]:
        shift_mm, turn = self._draws.standard_normal(3), self._draws.standard_normal(3)
        shift_mm *= self._between((0.0, PUSH_MM)) / np.linalg.norm(shift_mm)
        turn *= ARM_MM * math.radians(self._between((0.0, PUSH_DEG))) / np.linalg.norm(turn)
        pushed = looks.displacement(MovedBody.TRACKER, np.hstack([shift_mm, turn]))
        return format_lines(looks, MovedBody.TRACKER, pushed, ending)

    def _draw_ending(self, bodies: tuple[MovedBody, ...]) -> str:
        """Draw how a change comes about, and how long a hand holds the guide."""
        by_hand, slowly = bodies == (MovedBody.GUIDE,), self._happens(SLOW_SHARE)
        over = f" over {self._between(LEANING_S if by_hand else SLOWLY_S):.1f} s" if slowly else ""
        return over + (f" for {self._between(HELD_S):.1f} s" if by_hand else "")

    def _pick(self, choices: Sequence[One]) -> One:
        return choices[int(self._draws.integers(len(choices)))]

    def _happens(self, share: float) -> bool:
        return bool(self._draws.uniform() < share)

    def _between(self, limits: tuple[float, float]) -> float:
        return float(self._draws.uniform(*limits))


def _find_reach_mm(looks: Looks, bodies: tuple[MovedBody, ...]) -> float:
    """Return the largest effect of a move of these bodies that the looks hardly show, within its bounds."""
    if bodies == (MovedBody.TRACKER,):
        return FAINT_MM
    return min(GRAVE_MM, max(FAINT_MM, MOST_SIGMAS * find_hidden_moves(looks, bodies)[0].effect_mm))


def format_lines(looks: Looks, body: MovedBody, displacement: Matrix, ending: str) -> list[str]:
    """Return a displacement as a fault script has it: a shift, and a turn about the body's centre."""
    moved, centre_mm = displacement, looks.centre_mm(body)
    if body is MovedBody.SEAT:  # along the axes of the tip, about it
        moved, centre_mm = inverse(looks.tip) @ displacement @ looks.tip, np.zeros(3)
    shift = " ".join(f"{one:+.5f}" for one in apply(moved, centre_mm) - centre_mm)
    turn = " ".join(f"{one:+.6f}" for one in np.degrees(vector_from_rotation(moved[:3, :3])))
    return [f"room shift {body.value} {shift} mm{ending}", f"room turn {body.value} {turn} deg{ending}"]


def draw_adversarial_world(seed: int, number: int) -> AdversarialWorld:
    """Draw world `number` of a seed."""
    return Adversary(seed, number).draw()
