"""Order of views of the skin, and their turn about the tool axis, in which the arm takes the least time.

Near the head the arm moves slowly, so the time of a motion follows from its clearance. Clearance is computed
for the motions of the best tour so far only, until all of its motions are known.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from procedures.planning.skin_views import head_around, is_clear, turned_about_axis
from procedures.planning.visits import ArmSetting, Reached
from ronna_hw.arm.clearance.sweep import sweep_path
from ronna_hw.arm.motion.planning import plan_joint_move
from ronna_hw.arrays import Array
from ronna_hw.preview import allowed_speed
from ronna_hw.vectors import JointVector

SLOWER = 3.0  # usual duration beside the head, as a multiple of that in the open
LINES_S = 2.0  # off one place and on to another, if the arm cannot go straight there
MOST_ROUNDS = 30  # of tours whose motions are checked
LEAST_GAIN_S = 1e-6

Places = list[int]


def tour_views(
    setting: ArmSetting,
    views: Sequence[Reached],
    needed: int,
    look_s: float,
    limit_s: float,
    may_close: Sequence[bool] = (),
) -> tuple[Reached, ...]:
    """Return views, each perhaps turned about its axis, in the order that takes the arm least time.

    The first `needed` are all in it; of the others those are left out that take longest, until the tour, with
    `look_s` at each view, takes no more than `limit_s`. It ends once more at the first of the views that
    `may_close` it, if there are any.
    """
    if not views:
        return ()
    closing = {number for number, may in enumerate(may_close) if may}
    tour = _Tour(setting, [(view, *turned_about_axis(setting, view)) for view in views], closing)

    def is_too_long(order: Places) -> bool:
        closed = tour.close(order)
        return tour.duration_s(closed) + look_s * len(closed) > limit_s and len(order) > needed

    order = tour.find_order(tour.nearest_first())
    while is_too_long(order):
        while is_too_long(order):
            shorter = [[one for one in order if one != place] for place in order if place >= needed]
            order = min(shorter, key=lambda one: tour.duration_s(tour.close(one)))
        order = tour.find_order(order)
    return tuple(tour.views[number] for number in tour.choose_turns(tour.close(order)))


class _Tour:
    """Durations between all turns of all views, expected at first, and computed once they are checked."""

    def __init__(
        self, setting: ArmSetting, turns: Sequence[Sequence[Reached]], closing: Collection[int] = ()
    ) -> None:
        self._setting, self._around, self._closing = setting, head_around(setting), closing
        self.views = [view for each in turns for view in each]
        ends = np.cumsum([len(each) for each in turns])
        self._turns = [np.arange(end - len(each), end) for end, each in zip(ends, turns, strict=True)]
        self._joints = [*(view.at_rad for view in self.views), setting.start_rad]
        self._home = len(self.views)
        joints = np.array(self._joints)
        self._seconds = SLOWER * self._in_the_open(np.abs(joints[:, None] - joints[None]))
        self._checked: set[tuple[int, int]] = set()
        self._clear = {int(own[0]) for own in self._turns}  # chosen because they are

    def _in_the_open(self, travel_rad: Array) -> Array:
        """Return the duration of joint moves (..., 6) where nothing slows them, s."""
        limits = self._setting.limits
        travel = np.maximum(travel_rad, 1e-9)
        speed = (np.array(limits.speed_rad_s) / travel).min(axis=-1)
        acceleration = (np.array(limits.acceleration_rad_s2) / travel).min(axis=-1)
        reaches_speed = speed**2 < acceleration
        seconds = np.where(reaches_speed, 1.0 / speed + speed / acceleration, 2.0 / np.sqrt(acceleration))
        return np.asarray(seconds + limits.ramp_s)

    def nearest_first(self) -> Places:
        """Return an order of the places that goes on to the nearest."""
        here, rest, order = np.array([self._home]), list(range(len(self._turns))), Places()
        while rest:
            best = min(rest, key=lambda one: float(self._between(here, self._turns[one]).min()))
            rest.remove(best)
            order.append(best)
            here = self._turns[best]
        return order

    def find_order(self, order: Places) -> Places:
        """Shorten an order of places until all of its motions are known to be clear, or to lead via home."""
        for _ in range(MOST_ROUNDS):
            order = self._shorten(order)
            if not self._check(self.choose_turns(self.close(order))):
                break
        return order

    def _shorten(self, order: Places) -> Places:
        """Reverse parts of an order and move single places, as long as that saves time."""
        seconds = self.duration_s(self.close(order))
        while True:
            for other in _neighbours(order):
                if (shorter := self.duration_s(self.close(other))) < seconds - LEAST_GAIN_S:
                    order, seconds = other, shorter
                    break
            else:
                return order

    def close(self, order: Places) -> Places:
        """Return an order that ends once more at the first of its places that may close it."""
        return [*order, *[place for place in order if place in self._closing][:1]]

    def choose_turns(self, order: Places) -> Places:
        """Return the number of one turn of each place, with which this order takes the least time."""
        steps = self._steps(order)
        chosen = [int(steps[-1][0].argmin())]
        for _, before in reversed(steps[1:]):
            chosen.append(int(before[chosen[-1]]))
        return [int(self._turns[place][turn]) for place, turn in zip(order, reversed(chosen), strict=True)]

    def _check(self, chosen: Places) -> bool:
        """Compute the motions of a tour and the clearance of its views; return whether any was not known."""
        unknown = set(chosen) - self._clear
        for number in unknown:
            if self._around is None or is_clear(self._setting, self.views[number], self._around):
                self._clear.add(number)
            else:
                self._seconds[:, number] = np.inf
        legs = set(zip([self._home, *chosen], chosen, strict=False)) - self._checked
        for start, end in legs:
            if self._clear.issuperset({start, end} - {self._home}):
                self._seconds[start, end] = self._compute(start, end)
                self._checked.add((start, end))
        return bool(legs or unknown)

    def _compute(self, start: int, end: int) -> float:
        """Return the duration straight on to a view, else over the beginnings of both approaches, or home."""
        straight_s = self._drive(self._joints[start], self._joints[end])
        if straight_s < np.inf:
            return straight_s
        home_rad, onto_rad = self._joints[self._home], self.views[end].approach_rad
        off_rad = home_rad if start == self._home else self.views[start].approach_rad
        over_s = self._drive(off_rad, onto_rad)
        return LINES_S + min(over_s, self._drive(off_rad, home_rad) + self._drive(home_rad, onto_rad))

    def _drive(self, start_rad: JointVector, end_rad: JointVector) -> float:
        """Return the duration of a joint move, infinite if it is not clear."""
        setting, around = self._setting, self._around
        plan = plan_joint_move(setting.kinematics, start_rad, end_rad, setting.limits)
        expected_s = float(self._in_the_open(np.abs(np.subtract(start_rad, end_rad))))
        if around is None or plan.is_standstill:
            return expected_s
        path = sweep_path(setting.kinematics, plan, around, search_closest=False)
        if path.refused is not None:
            return np.inf
        speed = np.minimum(allowed_speed(path, setting.limits.body_speed_mm_s), plan.limits.velocity)
        return expected_s - 1.0 / plan.limits.velocity + float((np.diff(path.fractions) / speed).sum())

    def _between(self, start: NDArray[np.int64], end: NDArray[np.int64]) -> Array:
        return self._seconds[start[:, None], end]

    def duration_s(self, order: Places) -> float:
        """Return the duration of all motions, from home to the last place."""
        return float(self._steps(order)[-1][0].min())

    def _steps(self, order: Places) -> list[tuple[Array, NDArray[np.int64]]]:
        """Return for each place the least time until each of its turns, and the turn before it."""
        here, until = np.array([self._home]), np.zeros(1)
        steps: list[tuple[Array, NDArray[np.int64]]] = []
        for place in order:
            onwards = until[:, None] + self._between(here, self._turns[place])
            before = onwards.argmin(axis=0)
            here, until = self._turns[place], onwards.min(axis=0)
            steps.append((until, before))
        return steps


def _neighbours(order: Places) -> Iterator[Places]:
    """Yield the orders that differ by one reversed part, or by one place that is elsewhere."""
    for begin in range(len(order)):
        for end in range(begin + 2, len(order) + 1):
            yield [*order[:begin], *reversed(order[begin:end]), *order[end:]]
    for place in range(len(order)):
        others = order[:place] + order[place + 1 :]
        for there in range(len(order)):
            if there != place:
                yield [*others[:there], order[place], *others[there:]]
