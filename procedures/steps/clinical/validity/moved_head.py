"""What no longer holds when the head, the cart or the tracker has moved."""

from __future__ import annotations

from procedures.engine.context import StepContext
from procedures.guards.errors import BaseShifted, PatientMoved
from procedures.steps.clinical.cart_lock import LockedCart
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.registration import RegisteredRobot
from procedures.steps.clinical.validity.followed_move import MOST_FOLLOWED_MM
from procedures.workcell import MountedTool
from ronna_hw.errors import RonnaError


def void_moved(context: StepContext, moved: RonnaError) -> None:
    """The registrations while they may follow: with the guide mounted, after a small move; else all of it.

    A cart that has moved was not locked.
    """
    may_follow = (
        isinstance(moved, PatientMoved)
        and moved.moved_mm <= MOST_FOLLOWED_MM
        and context.workcell.tool is MountedTool.GUIDE
        and context.stands(RegisteredRobot)
    )
    if may_follow:
        context.void_each(RegisteredRobot, moved)
    elif isinstance(moved, BaseShifted) and moved.cart and context.stands(LockedCart):
        context.void(LockedCart, moved)
    else:
        context.void(GlobalLocalization, moved)
