"""An arm that is led by hand, before a case: slowly, within a reach, while a person holds a switch."""

from __future__ import annotations

from collections.abc import Callable

from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.errors import FORCE_NOT_SENSED
from ronna_hw.devices import RobotArm
from ronna_hw.devices.contact import FollowsHand, GuidanceEnd, Guided, HandGuidance


def lead_by_hand(
    arm: RobotArm,
    guidance: HandGuidance,
    surroundings: Surroundings,
    is_held: Callable[[], bool],
    is_over: Callable[[], bool],
) -> Guided | None:
    """Connect and start the arm; let it follow the hand whenever `is_held`, until `is_over`.

    Return the last guidance, or None if there was none; the arm is at rest and stopped. Raises ARM-013 for an
    arm that senses no force, and as `FollowsHand.guide_by_hand`.
    """
    if not isinstance(arm, FollowsHand):
        raise FORCE_NOT_SENSED(
            f"{arm.name} senses no force, so it follows no hand",
            action="Jog it with the controller's pendant.",
        )
    arm.connect()
    arm.configure()
    arm.surround(surroundings)
    last: Guided | None = None
    with arm.active():
        while not is_over():
            if not is_held():
                continue
            last = arm.guide_by_hand(guidance, lambda: is_held() and not is_over())
            if last.end is GuidanceEnd.TIMED_OUT:
                break
    return last
