"""Permissions of what a command writes: a run folder contains a patient's CT, plan, journal and report."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

ACCESS_VARIABLE = "RONNA_ACCESS"
_UMASKS = {"owner": 0o077, "group": 0o007}  # folders 0700 and files 0600, or 0770 and 0660


@contextmanager
def own_files() -> Iterator[None]:
    """In the block, this process and its children create files for their user only, whatever the umask.

    `RONNA_ACCESS=group` also admits the folder's group: for a folder that a lab shares. Raises
    ValueError for any other word.
    """
    access = os.environ.get(ACCESS_VARIABLE, "owner")
    if access not in _UMASKS:
        raise ValueError(f"{ACCESS_VARIABLE} is {access!r}; expected owner or group")
    before = os.umask(_UMASKS[access])
    try:
        yield
    finally:
        os.umask(before)
