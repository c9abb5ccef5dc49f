"""Instrument of the assistant beside the bore of the guide, by the estimate of the room.

What counts is where its clamp is, which holds the instrument, against the guide that the master holds: a cart
that turns about the frame leaves the frame in its place and leads the clamp away.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import RigidTransform
from scipy.special import chdtri

from procedures.guards.room_watch import JudgedReading, RoomWatch
from procedures.registration.error_theory import offset_limit_mm
from procedures.room.estimate import INSTRUMENT_IN_GUIDE, Displacement
from procedures.room.sighting import Rest, Sighting, Tracked, expect_frame
from procedures.workcell import Workcell
from procedures.workcell.assistant import Assistant
from ronna_hw.arrays import Array
from ronna_hw.devices.readings import TrackerFrame, Validity
from ronna_hw.frames import Frame, Transform

# By as much the shaft of an instrument bends between clamp and bore before it presses on the guide (U). It
# must leave room for what a look over the guide cannot tell, up to 0.4 mm.
# Safety against an instrument that bends between clamp and bore.
LARGEST_OFF_MM = 0.8

BETTER_FRAMES = 240  # 4 s, where a careful look is too weak
READINGS = 15  # averaged on the way
WATCH_FALSE_ALARM = 1e-5  # share of these means: an insertion has some tens of them
SIGMAS = 2.0  # standard errors that are told, along the direction across the bore that the looks show least
CONFIDENCE = 0.95  # that the instrument is no further beside the bore than it is said to be at most


@dataclass(frozen=True)
class BesideBore:
    """Instrument across the bore, at its upper end: how far it is seen beside it and may be."""

    seen_mm: float
    uncertain_mm: float  # two standard errors
    largest_mm: float  # 95 % limit
    chi_square: float  # of what is seen, with two degrees of freedom

    @property
    def is_within(self) -> bool:
        """Whether an arm may lead it along the bore."""
        return self.largest_mm <= LARGEST_OFF_MM

    @property
    def has_moved(self) -> bool:
        """Whether the instrument may be further off than it gives way, and is seen to have moved."""
        return not self.is_within and self.chi_square > float(chdtri(2, WATCH_FALSE_ALARM))

    def __str__(self) -> str:
        return (
            f"seen {self.seen_mm:.2f} mm beside the bore, known to {self.uncertain_mm:.2f} mm: within "
            f"{self.largest_mm:.2f} mm (at most {LARGEST_OFF_MM:g} mm)"
        )


def beside_bore(workcell: Workcell, watch: RoomWatch, judged: JudgedReading) -> BesideBore | None:
    """Return how far the instrument may be beside the bore by a look at rest, None if its arm is not seen.

    Both carts may have moved at any moment since the arm was last home, as all looks since show together: the
    worst of those moments counts. An arm with the guide whose frame is hidden counts by its joints, as it
    does where nobody else works at the head.
    """
    seen = judged.look.frames.keys()
    if Tracked.ASSISTANT not in seen:
        return None
    bodies = INSTRUMENT_IN_GUIDE if Tracked.ARM in seen else {"assistant": 1.0}
    estimate, top_mm = watch.including(judged), _top_of_bore_mm(workcell, workcell.master.tool_pose())
    last = len(estimate.looks) - 1
    moments = range(min(watch.settled_home + 1, last), last + 1)
    displaced = (estimate.displacement(top_mm, since, bodies) for since in moments)
    beside = (_across(workcell.master.tool_pose(), one) for one in displaced)
    return max(beside, key=lambda one: one.largest_mm)


@dataclass
class AssistantOnAxis:
    """Watch over an assistant that leads an instrument through the guide, or out, frame by frame."""

    workcell: Workcell
    assistant: Assistant
    watch: RoomWatch
    now: BesideBore | None = None
    _guide: Transform = field(init=False)  # at rest meanwhile: its arm may be lost on the way
    _recent: deque[tuple[Transform, Transform]] = field(
        default_factory=lambda: deque(maxlen=READINGS)
    )  # by the joints, by the tracker

    def __post_init__(self) -> None:
        """Take the guide to rest where it is."""
        self._guide = self.workcell.master.tool_pose()

    def add_frame(self, frame: TrackerFrame) -> None:
        """Add a tracker frame, as from where the tracker was localized.

        `now` is by the latest `READINGS` of them.
        """
        assistant, by_arm = self.assistant, self.watch.frame_by_arm(Tracked.ASSISTANT)
        known, reading = assistant.arm.observe().reading, frame.tool(assistant.holder.frame)
        if reading.validity is not Validity.OK or known is None or by_arm is None:
            return
        self._recent.append((by_arm(known.joints_rad, None), reading.transform(Frame.TRACKER, Frame.MARKER)))
        if len(self._recent) < READINGS:
            return
        # As the frame would have been seen where the arm has it now: it has gone on meanwhile.
        here = self._recent[-1][0]
        poses = RigidTransform.concatenate(
            [(here @ there.inverse() @ seen).rigid for there, seen in self._recent]
        )
        mean, markers_mm = poses.mean(), self.workcell.tracker.markers_mm[assistant.holder.frame]
        # By the stated noise: the scatter of frames before and after a move would hide it.
        shown = expect_frame(mean.translation, mean.rotation.as_matrix(), markers_mm, READINGS)
        rest = {Tracked.ASSISTANT: Rest(known.joints_rad)}
        look = Sighting(rest, frames={Tracked.ASSISTANT: shown}, tracker=self.watch.tracker.pushes)
        top_mm = _top_of_bore_mm(self.workcell, self._guide)
        self.now = _across(self._guide, self.watch.displacement_by(look, top_mm, {"assistant": 1.0}))


def _top_of_bore_mm(workcell: Workcell, guide: Transform) -> Array:
    """Return the upper end (3,) of the bore of a guide, robot frame."""
    bore = workcell.tools.guide.bore
    return np.asarray(guide.apply((0.0, 0.0, -bore.reach_mm - bore.length_mm)))


def _across(guide: Transform, displaced: Displacement) -> BesideBore:
    """Return a displacement of the instrument across the bore of a guide."""
    across = guide.rotation_matrix[:, :2].T
    way_mm, covariance_mm2 = across @ displaced.way_mm, across @ displaced.covariance_mm2 @ across.T
    chi_square = float(way_mm @ np.linalg.solve(covariance_mm2, way_mm))
    uncertain_mm = SIGMAS * math.sqrt(float(np.linalg.eigvalsh(covariance_mm2)[-1]))
    largest_mm = offset_limit_mm(way_mm, covariance_mm2, CONFIDENCE)
    return BesideBore(math.hypot(*way_mm), uncertain_mm, largest_mm, chi_square)
