"""Feed of a drill by the force against it, and the breakthrough by force and depth.

The feed is slowed as the force comes near its limit, and rests until the drill has cut free. A breakthrough
shows in two ways: beyond a planned depth the force falls to a share of its largest there; at any depth, once
bone was met, nothing resists over some way. The first tells the inner cortex from the diploe by the CT, the
second needs no CT and stops a drill in bone that is thinner than the CT shows. Where no bone is felt although
the drill is well behind the skull's outside by the CT, the force says nothing, and the feed stops.

All of this goes by the force along the axis, less the friction that the force across it can make in the
guide: that is no bone. Where what is left could be friction or soft bone over the way of a breakthrough, the
force across hides it, and the feed stops. It also bends guide and drill, and has a limit of its own.
"""

from __future__ import annotations

from math import hypot, sqrt
from typing import NamedTuple

from ronna_hw.vectors import Vector3

FEED_STEPS = 10  # the feed follows the force in tenths: a profile is planned anew for each
FALL_CYCLES = 5  # in a row, until a fall counts
# Safety against a drill that is pressed and does not cut (U).
LONGEST_REST_S = 2.0  # of a feed: a drill that turns cuts itself free in a fifth of a second
BINS = 32  # of a path, whose largest forces are kept


class DrillWatch(NamedTuple):
    """Forces (N) and places of a path, as shares of its length, by which a drill is fed and stopped."""

    slow_N: float  # from here on the feed is slowed
    hold_N: float  # here it rests
    touch_N: float  # more than anything but bone resists
    free_N: float  # less than any bone resists
    fall_share: float  # of the largest force beyond `earliest`, below which the inner cortex is cut through
    earliest: float  # from here on such a fall counts
    free: float  # way over which nothing resists
    bone_from: float  # from here on, below an opening begun earlier, whatever resists is bone
    bone_by: float  # up to here bone must have been met
    side_N: float  # more across the axis bends what leads the drill
    friction: float  # share of the force across it that may resist the feed without bone
    axis: Vector3  # direction of the feed, robot base

    def split(self, change_N: Vector3) -> tuple[float, float]:
        """Return the force against the feed, and the one across it; a pull along it counts as none."""
        along_N = -sum(force * share for force, share in zip(change_N, self.axis, strict=True))
        across_N = sqrt(max(hypot(*change_N) ** 2 - along_N**2, 0.0))
        return max(along_N, 0.0), across_N


class DrillFeed:
    """State of one motion of a drill."""

    def __init__(self, watch: DrillWatch, cycle_s: float, *, in_bone: bool, free_share: float = 0.0) -> None:
        """Begin at the start of a path; `in_bone` if it goes on after a stop, and bone was met before.

        `free_share` is the way before that stop on which nothing resisted, as a share of `watch.free`.
        """
        self._watch = watch
        self.free_share = free_share
        self.in_bone = in_bone
        self.has_missed_bone = self.is_pushed_aside = self.is_hidden = False
        self.peak_side_N = 0.0
        self._peak_N = 0.0  # beyond `earliest`
        self._resisted = -free_share * watch.free  # where bone last did
        self._pressed = self._resisted  # where bone or friction last did
        self._falls = self._resting = 0  # cycles
        self._most_resting = round(LONGEST_REST_S / cycle_s)
        self.share = 1.0  # of the planned feed
        self.has_broken_through = False
        self.slowed_cycles = 0
        self.forces_N = [0.0] * BINS

    @property
    def has_stalled(self) -> bool:
        """Whether the feed has rested for too long: the drill does not cut."""
        return self._resting > self._most_resting

    @property
    def has_ended(self) -> bool:
        """Whether the feed ends here, for whichever reason."""
        ended = self.has_broken_through or self.has_stalled or self.has_missed_bone
        return ended or self.is_pushed_aside or self.is_hidden

    def note(self, change_N: Vector3, along: float) -> None:
        """Take the change of the force of one cycle, robot base, at a share of the path."""
        watch = self._watch
        force_N, side_N = watch.split(change_N)
        self.peak_side_N = max(self.peak_side_N, side_N)
        self.is_pushed_aside |= side_N > watch.side_N
        place = min(int(along * BINS), BINS - 1)
        self.forces_N[place] = max(self.forces_N[place], force_N)
        over = (watch.hold_N - hypot(force_N, side_N)) / (watch.hold_N - watch.slow_N)
        self.share = int(min(max(over, 0.0), 1.0) * FEED_STEPS + 0.5) / FEED_STEPS
        self.slowed_cycles += self.share < 1.0
        self._resting = 0 if self.share else self._resting + 1
        bone_N = max(force_N - watch.friction * side_N, 0.0)
        self.in_bone |= bone_N >= (watch.free_N if along >= watch.bone_from else watch.touch_N)
        if bone_N >= watch.free_N or not self.in_bone:
            self._resisted = along
        if force_N >= watch.free_N or not self.in_bone:
            self._pressed = along
        self.free_share = (along - self._resisted) / watch.free
        if not self.in_bone:
            self.has_missed_bone = along >= watch.bone_by
            return
        if along >= watch.earliest:
            self._peak_N = max(self._peak_N, bone_N)
            has_fallen = self._peak_N >= watch.touch_N and bone_N < watch.fall_share * self._peak_N
            self._falls = self._falls + 1 if has_fallen else 0
        is_free = along - self._pressed >= watch.free
        self.has_broken_through |= self._falls >= FALL_CYCLES or is_free
        self.is_hidden |= self.free_share >= 1.0 and not self.has_broken_through
