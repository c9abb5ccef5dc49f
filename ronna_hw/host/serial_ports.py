"""Who may use a serial port of this computer."""

from __future__ import annotations

import grp
import os
import pwd
import stat


def permissions(path: str) -> str:
    """Mode, owner and group of a port, as `ls -l` shows them."""
    try:
        status = os.stat(path)
    except OSError as error:
        return str(error.strerror)
    return f"{stat.filemode(status.st_mode)} {_owner(status.st_uid)} {_group(status.st_gid)}"


def permission_advice(path: str) -> str:
    """Who may use a port, and how to become one of them."""
    try:
        status = os.stat(path)
    except OSError:
        return "Join the group that owns it (often dialout), then log in again."
    group = _group(status.st_gid)
    mode = stat.filemode(status.st_mode)
    if status.st_mode & stat.S_IRGRP and status.st_mode & stat.S_IWGRP:
        return f"It belongs to group {group} ({mode}): sudo usermod -aG {group} $USER, then log in again."
    return f"Its mode {mode} excludes even its group {group}: have its udev rule corrected."


def _owner(number: int) -> str:
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:
        return str(number)


def _group(number: int) -> str:
    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)
