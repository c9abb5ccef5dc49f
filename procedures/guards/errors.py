"""Errors raised by guards: a changed cart, tracker, head or input."""

from __future__ import annotations

import math
from typing import Self

from procedures.calibration.errors import PlatformMoved
from ronna_hw.errors import ErrorCode, RefusedError
from ronna_hw.frames import Transform
from ronna_hw.text import format_distinct

OF_POINTS = " rms of its points"  # kind of a displacement
LOCALIZED_AGAIN = (
    "resume the run, or go on with the next step. With the guide mounted, send the arm home first."
)


class BaseShifted(RefusedError):
    """Tracker and arm disagree on the position of the frame on the arm: the cart or the tracker was moved."""

    code = "PRO-019"
    action = (
        "See that nobody leans on the arm. Find out what was moved and lock it; then continue from cart_lock "
        "if it was the cart, otherwise from global_localization. With the guide mounted, send the arm home "
        "first."
    )
    cart: bool = True  # else it was the tracker
    room_moved: Transform | None = None  # against a moved cart, robot frame, as far as one look tells
    frame_off_mm: float | None = None  # if no look tells that: the frame on the arm from where the arm has it


INPUT_CHANGED = ErrorCode(
    "PRO-021",
    RefusedError,
    "The CT, the plan or the proposed cart position has changed since the case was computed from it.",
    (
        "Find out who changed it. Everything computed from it is superseded: run the steps again or, with "
        "the guide mounted, go home and start a new run."
    ),
)


class FrameSlipped(RefusedError):
    """The patient's frame has moved on the head clamp: the spheres have not moved with it."""

    code = "PRO-051"
    action = f"Fasten it to the clamp, then register again: {LOCALIZED_AGAIN}"


class PatientUnseen(RefusedError):
    """The tracker cannot see the head, so the guide may not move towards it."""

    code = "PRO-022"
    action = (
        "Clear the tracker's line of sight to the spheres and to the frame on the arm: drapes, blood, "
        "people, hands, sunlight. Then run the step again; it goes via home."
    )


class InsertionDisturbed(RefusedError):
    """The guide was pushed, or the assistant moved, on the assistant's way through the guide."""

    code = "PRO-054"
    action = (
        "Touch neither instrument nor arms, and find out what was pushed. Nothing retreats by itself: repeat "
        "the step. The tracker compares the frames of both arms; where they agree, the assistant leads the "
        "instrument out once that is confirmed, and otherwise staff take it out by hand, as is then said."
    )
    by_hand = (
        "No arm leads the instrument out; move none while it is in the guide. By hand: switch off a drill "
        "that turns, hold the instrument or drill, "
        "open the clamp of the assistant's holder, and draw it straight out of the guide. Lock "
        "the carts, jog the assistant home with its pendant, then repeat the command"
    )


class RoomUndecided(RefusedError):
    """Something was moved, pushed or loaded, and the arm's present pose does not tell what.

    Nothing is void yet. With the arm home, the next look follows a pushed tracker or names what has moved.
    """

    code = "PRO-052"
    action = (
        "Lock clamp and tracker and send the arm home, then run the step again: there the frame on the arm "
        "tells a pushed tracker, which is followed, from a moved head."
    )


class PatientMoved(RefusedError):
    """The head has moved since it was localized. `moved_mm` is the rms displacement of what shows it.

    Where that shows less than the way of the head in its clamp, or of a target, it is this way.
    """

    code = "PRO-020"
    action = (
        f"Check the clamp, its frame and the spheres, then localize again: {LOCALIZED_AGAIN} After a small "
        "move, the registration step then asks whether a registration by spheres should follow it; one on "
        "the skin is confirmed by a few looks."
    )
    without_spheres = (
        f"Check the clamp and its frame, then localize again: {LOCALIZED_AGAIN} After a small move, a few "
        "looks confirm a registration on the skin that was accepted before."
    )
    moved_mm: float = math.inf

    @classmethod
    def from_shift(
        cls, what: str, moved_mm: float, limit_mm: float, kind: str = OF_POINTS, *, on_skin: bool = False
    ) -> Self:
        """Build the error for a displacement of a kind; `on_skin`: of a head without spheres."""
        got, limit = format_distinct(moved_mm, limit_mm, 2)
        action = cls.without_spheres if on_skin else None
        moved = cls(what, limit=f"{limit} mm", got=f"{got} mm{kind}", action=action)
        moved.moved_mm = moved_mm
        return moved


RoomMoved = (
    BaseShifted | PatientMoved | FrameSlipped | PlatformMoved
)  # after any of them the localization does not hold
