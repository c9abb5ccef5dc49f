"""Random worlds: a scene, and at most one change between re-localization and the last retreat.

It depends only on its seed and number, so that every one can be repeated alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

# Steps that may be running when something changes, and about how long each takes in theatre time.
STEPS_S = {"tool_change": 1.7, "tool_check": 5.7, "positioning": 5.0, "at_target": 2.6, "retreat": 1.5}
OF_ALL = ("tool_change", "tool_check")  # run once, for all trajectories
MOST_MM, MOST_DEG = 3.0, 1.0  # of head, cart and tracker
MOST_BENT_MM, MOST_SEAT_MM, MOST_SEAT_DEG, MOST_CAMERA_DEG = 1.5, 1.5, 0.3, 0.1
HIDDEN_SHARE, ALL_HIDDEN_SHARE, FOR_A_WHILE_SHARE = 0.5, 0.5, 0.5
LONGEST_HIDDEN_S = 15.0
MINI, MINI_MARKERS = "mini", 3
SCENES = (MINI, "default")


class ChangedObject(StrEnum):
    """Kind of object affected by the change."""

    HEAD = "head"
    CART = "cart"
    TRACKER = "tracker"
    TIP = "guide tip"
    SEAT = "guide seat"
    CAMERA = "camera"


def fault_script(step: str, after_s: float, lines: Iterable[str]) -> str:
    """Return the fault script of lines that take effect some time after a step first began."""
    return "".join(f"since step == {step} after {after_s:.3f} s: {one}\n" for one in lines)


@dataclass(frozen=True)
class Change:
    """A lasting change, possibly with spheres hidden from the tracker. `lines` form a fault script."""

    what: ChangedObject
    step: str
    after_s: float  # since that step first began
    lines: tuple[str, ...]
    hidden: str = ""

    @property
    def moment(self) -> str:
        return f"{self.step} + {self.after_s:.2f} s"

    @property
    def script(self) -> str:
        return fault_script(self.step, self.after_s, self.lines)

    @property
    def words(self) -> str:
        changed = "; ".join(one for one in self.lines if not one.startswith("tracker occlude"))
        return f"{changed}, {self.hidden}" if self.hidden else changed


@dataclass(frozen=True)
class DrawnWorld:
    """A case: its scene, and the change during it, if any."""

    number: int
    scene: str
    scene_seed: int
    markers: int
    targets: int
    change: Change | None

    @property
    def arguments(self) -> list[str]:
        """Command-line options of `ronna-procedure run` for the case, excluding its fault script."""
        options = ["--sim", "--scene", self.scene, "--seed", str(self.scene_seed)]
        return [*options, "--markers", str(self.markers), "--targets", str(self.targets)]


def draw_world(seed: int, number: int, scene: str = MINI, *, quiet: bool = False) -> DrawnWorld:
    """Draw world `number` of a seed. A quiet world has no change."""
    generator = np.random.default_rng(np.random.SeedSequence([seed, number, int(quiet)]))
    mini = scene == MINI
    scene_seed = int(generator.integers(0, 10_000))
    markers = MINI_MARKERS if mini else int(generator.integers(3, 9))
    targets = int(generator.integers(1, 3 if mini else 4))
    change = None if quiet else _draw_change(generator, markers, targets)
    return DrawnWorld(number, scene, scene_seed, markers, targets, change)


def _draw_change(generator: np.random.Generator, markers: int, targets: int) -> Change:
    what = list(ChangedObject)[int(generator.integers(len(ChangedObject)))]
    name = list(STEPS_S)[int(generator.integers(len(STEPS_S)))]
    after_s = round(float(generator.uniform(0.0, STEPS_S[name])), 3)
    step = name if name in OF_ALL else f"{name}:T{int(generator.integers(1, targets + 1))}"
    lines = _draw_change_lines(generator, what)
    hidden = ""
    if generator.uniform() < HIDDEN_SHARE:
        whole = generator.uniform() < ALL_HIDDEN_SHARE
        count = markers if whole else int(generator.integers(1, markers))
        numbers = sorted(int(one) + 1 for one in generator.permutation(markers)[:count])
        lasts_s = float(generator.uniform(1.0, LONGEST_HIDDEN_S))
        ends = generator.uniform() < FOR_A_WHILE_SHARE
        duration = f" for {lasts_s:.1f} s" if ends else ""
        lines += [f"tracker occlude marker {one}{duration}" for one in numbers]
        hidden = f"{count} of {markers} spheres hidden{duration or ' until the end'}"
    return Change(what, step, after_s, tuple(lines), hidden)


def _draw_change_lines(generator: np.random.Generator, what: ChangedObject) -> list[str]:
    if what is ChangedObject.TIP:
        x, y = _draw_plane_vector(generator, MOST_BENT_MM)
        return [f"room bent tip {x:+.3f} {y:+.3f} 0 mm"]
    if what is ChangedObject.SEAT:
        off_mm = generator.uniform(-MOST_SEAT_MM, MOST_SEAT_MM)
        tilt_deg = generator.uniform(-MOST_SEAT_DEG, MOST_SEAT_DEG)
        return [f"room bad seat {off_mm:+.3f} mm {tilt_deg:+.3f} deg"]
    if what is ChangedObject.CAMERA:
        side = ("left", "right")[int(generator.integers(2))]
        return [f"camera twist {side} {generator.uniform(-MOST_CAMERA_DEG, MOST_CAMERA_DEG):+.4f} deg"]
    shift = " ".join(f"{value:+.3f}" for value in _draw_vector(generator, MOST_MM))
    lines = [f"room shift {what.value} {shift} mm"]
    if what is not ChangedObject.TRACKER:
        turn = " ".join(f"{value:+.3f}" for value in _draw_vector(generator, MOST_DEG))
        lines.append(f"room turn {what.value} {turn} deg")
    return lines


def _draw_vector(generator: np.random.Generator, most: float) -> list[float]:
    normal_draw = generator.standard_normal(3)
    return [
        float(value) for value in normal_draw * (generator.uniform(0.0, most) / np.linalg.norm(normal_draw))
    ]


def _draw_plane_vector(generator: np.random.Generator, most: float) -> tuple[float, float]:
    length, angle = generator.uniform(0.0, most), generator.uniform(0.0, 2.0 * math.pi)
    return float(length * math.cos(angle)), float(length * math.sin(angle))
