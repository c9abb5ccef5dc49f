"""Looks for what is not where it is expected: the search pattern as far as the arm can take its poses."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from itertools import count

from procedures.relocalization import search_pose
from procedures.relocalization.errors import SphereNotInView
from procedures.workcell.arm_view import ArmView
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.errors import LimitError
from ronna_hw.frames import Transform


def settled_around(
    expected: Transform, settle: Callable[[Transform], object], arm: ArmView
) -> Iterator[Transform]:
    """Settle onto one pose after another around the expected one, and give those taken.

    The search leads beyond the checked path: poses refused before the arm moves are passed over. Raises
    STE-009 after the last, and what trips the arm.
    """
    passed = 0
    for number in count():
        try:
            pose = search_pose(expected, number)
        except SphereNotInView as error:
            if not passed:
                raise
            what = f"no sphere in {number - passed} image pairs, {passed} poses not clear"
            raise SphereNotInView(what, limit=error.limit) from error
        if refusal(partial(settle, pose), arm) is None:
            yield pose
        else:
            passed += 1


def refusal(move: Callable[[], object], arm: ArmView) -> LimitError | None:
    """Why a motion was refused before the arm moved; None when it is done. One that trips the arm raises."""
    try:
        move()
    except LimitError as error:
        if arm.state is not Lifecycle.ACTIVE:
            raise
        return error
    return None
