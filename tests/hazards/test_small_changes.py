"""Hazards 3, 12, 13: one change at a random moment between the re-localization and the last retreat.

The looks of a case, in this process: the scene's true arm, the tracker's bias and noise, and the watch that
the case uses. What a target is off by is judged by truth, against the predicted limit. The error of a case in
which nothing changes is drawn as predicted; `ronna-campaign worlds` draws whole cases through the wires.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import pytest
from room_trials import TrackedCase
from scipy.spatial.transform import Rotation

from procedures.guards.room_reading import CAREFUL_FRAMES
from procedures.guards.room_watch import RoomLook, RoomWatch
from procedures.guards.stability import GUIDE_NOTICEABLE_MM
from procedures.registration.error_theory import rare_limit_mm
from procedures.registration.target_prediction import RARE_SHARE
from procedures.steps.clinical.tool_check import APPROACHES
from procedures.strategies.strategy import ONE_SIDE
from ronna_hw.arrays import Array
from ronna_hw.vectors import JointVector
from sim.world.rigid import apply, matrix_from

HONEST_MM = 0.19  # predicted rms without any change, default scene
MOST_MM, MOST_DEG, MOST_BENT_MM = 3.0, 1.0, 1.5
TARGETS = 3
DIAL_MM = 0.024  # per axis and approach: the mean of three is then beyond the limit in 4 of 1,000
# Theatre time from the tool change to the look before the gauge, to the look before a target, to that at the
# target, to the instrument at depth, to the look after it.
TO_GAUGE_S, TO_LOOK_S, TO_TARGET_S, TO_DEPTH_S, TO_AFTER_S = 2.0, 6.0, 4.0, 3.0, 9.0
SILENT_SHARE = 0.05


@dataclass(frozen=True)
class Change:
    """What changes, when, and whether the tracker sees the head afterwards."""

    what: str = "nothing"  # head, cart or tip
    at_s: float = math.inf
    way_mm: Array = field(default_factory=lambda: np.zeros(3))
    turn_rad: Array = field(default_factory=lambda: np.zeros(3))
    hidden: bool = False

    @classmethod
    def drawn(cls, generator: np.random.Generator) -> Change:
        """One at any moment up to the end of the last retreat."""

        def vector(most: float) -> Array:
            way = generator.standard_normal(3)
            return np.asarray(generator.uniform(0.0, most) * way / np.linalg.norm(way))

        what = str(generator.choice(["head", "cart", "tip"]))
        last_s = TO_GAUGE_S + TARGETS * (TO_LOOK_S + TO_TARGET_S + TO_DEPTH_S + TO_AFTER_S)
        return cls(
            what,
            float(generator.uniform(0.0, last_s - TO_AFTER_S / 2)),
            vector(MOST_BENT_MM if what == "tip" else MOST_MM),
            np.radians(vector(MOST_DEG)),
            bool(generator.random() < 0.5),
        )

    def of(self, what: str, now_s: float, about_mm: Array) -> Array:
        """Displacement (4, 4) of that, about a point, by now."""
        if self.what != what or now_s < self.at_s:
            return np.eye(4)
        turn = Rotation.from_rotvec(self.turn_rad).as_matrix()
        return matrix_from(about_mm - turn @ about_mm + self.way_mm, turn)


@dataclass
class Trial:
    """One case with one change: what was said of each target, and by how much it was off."""

    world: TrackedCase
    change: Change
    generator: np.random.Generator

    def run(self) -> list[tuple[float, bool]]:
        """Error over the predicted limit at each target that was reached, and whether a finding names it."""
        world, home_rad = self.world, self.world.home_rad
        watch = world.begin()
        reached: list[tuple[float, bool]] = []
        before = [home_rad, *(place for one in world.visits[:TARGETS] for place in one.over_spheres)]
        for place in before:  # nothing changes before the spheres are localized again
            assert not self._stops(self._look(watch, -math.inf, place))
        now_s = TO_GAUGE_S
        if self._stops(self._look(watch, now_s, home_rad)) or not self._guide_passes(now_s):
            return reached
        for visit in world.visits[:TARGETS]:
            now_s += TO_LOOK_S
            if self._stops(self._look(watch, now_s, home_rad)):
                return reached
            now_s += TO_TARGET_S
            look = self._look(watch, now_s, visit.at)
            if look.moved is not None:
                return reached
            limit = limit_mm(watch, visit.target)
            now_s += TO_DEPTH_S
            off = self._error_mm(watch.points_mm[visit.target], now_s)
            now_s += TO_AFTER_S
            doubted = not self._guide_passes(now_s) or self._stops(self._look(watch, now_s, home_rad))
            reached.append((off / limit, doubted))
            if doubted:
                return reached
        return reached

    @staticmethod
    def _stops(look: RoomLook) -> bool:
        return look.moved is not None or look.head_mm is None or look.base_mm is None

    def _error_mm(self, place_mm: Array, now_s: float) -> float:
        """Of the instrument's end against the target, with what has changed by now."""
        world, honest = self.world, self.generator.normal(0.0, HONEST_MM / math.sqrt(3.0), 3)
        middle = world.spheres_mm.mean(axis=0)
        head = self.change.of("head", now_s, middle)
        cart = self.change.of("cart", now_s, np.zeros(3))
        bent = self.change.way_mm if self.change.what == "tip" and now_s >= self.change.at_s else np.zeros(3)
        away = apply(cart, [place_mm])[0] - apply(head, [place_mm])[0] + bent
        return float(np.linalg.norm(honest + away))

    def _guide_passes(self, now_s: float) -> bool:
        """On the gauge: the mean of three readings, or of six."""
        bent = self.change.way_mm if self.change.what == "tip" and now_s >= self.change.at_s else np.zeros(3)
        read_mm = bent + self.generator.normal(0.0, DIAL_MM, (2 * APPROACHES, 3))
        means = (read_mm[:APPROACHES].mean(axis=0), read_mm.mean(axis=0))
        return any(float(np.linalg.norm(mean)) <= GUIDE_NOTICEABLE_MM for mean in means)

    def _look(self, watch: RoomWatch, now_s: float, joints_rad: JointVector) -> RoomLook:
        world, hidden = self.world, self.change.hidden and now_s >= self.change.at_s
        head = self.change.of("head", now_s, world.spheres_mm.mean(axis=0))
        cart = self.change.of("cart", now_s, np.zeros(3))
        true = world.at_rest(joints_rad, ONE_SIDE, int(self.generator.integers(1 << 30)))
        reading = world.read(
            watch, joints_rad, true, CAREFUL_FRAMES, head=head, cart=cart, sides=ONE_SIDE, hidden=hidden
        )
        return watch.compare(reading)


def limit_mm(watch: RoomWatch, target: str) -> float:
    """Radius that holds the error at the stated confidence, with what no look would notice."""
    last, point_mm = len(watch.estimate.looks) - 1, watch.points_mm[target]
    base = watch.estimate.displacement(point_mm, last, {"base": 1.0}).covariance_mm2
    head = watch.estimate.displacement(point_mm, last - 1, {"head": -1.0}).covariance_mm2
    rest = (HONEST_MM**2 + GUIDE_NOTICEABLE_MM**2 / 3.0) / 3.0 * np.eye(3)
    return rare_limit_mm(rest, base + head, RARE_SHARE)


def trials(count: int, *, quiet: bool) -> list[list[tuple[float, bool]]]:
    """So many cases, 20 to a scene."""
    results = []
    for number in range(count):
        if number % 20 == 0:
            world = TrackedCase(number // 20)
        generator = np.random.default_rng([number, 44])
        change = Change() if quiet else Change.drawn(generator)
        results.append(Trial(world, change, generator).run())
    return results


COUNTS = [40, pytest.param(500, marks=pytest.mark.slow)]


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.hazard(3)
@pytest.mark.hazard(12)
@pytest.mark.hazard(13)
def test_no_target_is_silently_off_by_more_than_predicted_after_a_random_change(count: int) -> None:
    silent = [
        off for case in trials(count, quiet=False) for off, doubted in case if off > 1.0 and not doubted
    ]
    assert len(silent) <= SILENT_SHARE * count
    assert max(silent, default=0.0) <= 2.0


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.hazard(12)
@pytest.mark.hazard(13)
def test_a_quiet_case_has_no_finding(count: int) -> None:
    for case in trials(count, quiet=True):
        assert [doubted for _, doubted in case] == [False] * TARGETS
