"""What has moved that must not."""

from __future__ import annotations

import math
from typing import Self

from ronna_hw.errors import RefusedError
from ronna_hw.text.beyond import beyond


class BaseShifted(RefusedError):
    """Tracker and arm no longer agree about where the frame on the arm is: cart or tracker was moved."""

    code = "PRO-019"
    action = (
        "Find out what was moved and lock it; then go on from cart_lock when it was the cart, else from "
        "global_localization. With the guide mounted send the arm home first."
    )
    cart: bool = True  # else it was the tracker


class InputChanged(RefusedError):
    """CT, plan or proposed place is no longer what the case was computed from."""

    code = "PRO-021"
    action = (
        "Find out who changed it. What was computed from it is superseded: run the steps again, or with the "
        "guide mounted go home and begin a new run."
    )


class PatientUnseen(RefusedError):
    """The tracker does not see the head where it has to, before a guide goes to it."""

    code = "PRO-022"
    action = (
        "Clear the tracker's sight of the spheres: drapes, blood, people, hands. Then run the step again; it "
        "leads by home."
    )


class PatientMoved(RefusedError):
    """The spheres on the head are not where they were localized. `moved_mm` is the rms of their ways."""

    code = "PRO-020"
    action = (
        "Check clamp and spheres, then localize again from global_localization on. With the guide mounted "
        "send the arm home first; after a small move the step registration asks there whether it follows."
    )
    moved_mm: float = math.inf

    @classmethod
    def by(cls, what: str, moved_mm: float, limit_mm: float) -> Self:
        """A move of that size."""
        moved = cls(what, limit=f"{limit_mm:g} mm", got=f"{beyond(moved_mm, limit_mm, 2)} mm")
        moved.moved_mm = moved_mm
        return moved
