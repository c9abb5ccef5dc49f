"""Roles of the arms in a case: names of theatre files, journals, displays and simulators.

A module of its own, since commands name roles before anything that costs time is imported.
"""

from __future__ import annotations

MASTER = "master"  # carries stereo head and guide; its base is the robot frame
ASSISTANT = "assistant"  # carries the instrument

ONE_ARM = (MASTER,)
TWO_ARMS = (MASTER, ASSISTANT)  # the master first, wherever arms are listed
CASES = (ONE_ARM, TWO_ARMS)  # what a case may have


def roles_of(*, dual: bool) -> tuple[str, ...]:
    """Return the roles of a case with one arm or, on request, with two."""
    return TWO_ARMS if dual else ONE_ARM
