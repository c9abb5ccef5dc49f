"""Processes using a serial port, network port or lock, and who may use a port, as this user sees."""

from __future__ import annotations

import contextlib
import grp
import os
import pwd
import socket
import stat
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import psutil

LONGEST_NAME = 60  # characters of a command line shown
MASTER_NAME = "ptmx"  # the device behind the master side of every pseudo-terminal
ANY_ADDRESS = "0.0.0.0"
LEAVE_A_CASE_ALONE = "If it runs a case, leave it alone: its arm may be at a patient."
OF_OURS = ["-P", "-m"]  # how our programs start the processes that serve them
_INDEX = "tty-index:"
_FIRST_MAJOR, _LAST_MAJOR = 136, 143  # of pseudo-terminals on Linux, 256 to each


@dataclass(frozen=True)
class PortUser:
    """Process that has a port or lock open."""

    pid: int
    name: str  # its command line
    terminal: str = ""  # where it can be typed at, if known

    def __str__(self) -> str:
        return f"{self.name} (pid {self.pid}{', ' * bool(self.terminal)}{self.terminal})"


def find_serial_port_users(path: str) -> tuple[PortUser, ...]:
    """List other processes that have this port open, except the master side of a pseudo-terminal."""
    try:
        device = os.stat(path).st_rdev
    except OSError:
        return ()
    found = []
    for pid in psutil.pids():
        files = tuple(_open_devices(pid))
        opened = pid != os.getpid() and any(_is_device(file, device) for file in files)
        if opened and not any(_is_master_of(file, device) for file in files):
            found.append(_identify_user(pid))
    return tuple(found)


def find_udp_port_user(address: str, port: int) -> PortUser | None:
    """Find the local process bound to a UDP port, or return None if there is none or it is hidden."""
    for connection in psutil.net_connections(kind="udp4"):
        if connection.pid and connection.laddr.port == port and connection.laddr.ip in (address, ANY_ADDRESS):
            return _identify_user(connection.pid)
    return None


def find_tcp_listener(address: str, port: int) -> PortUser | None:
    """Find the local process listening on a TCP port, or return None if there is none or it is hidden."""
    for connection in psutil.net_connections(kind="tcp4"):
        listens = connection.status == psutil.CONN_LISTEN and connection.laddr.port == port
        if connection.pid and listens and connection.laddr.ip in (address, ANY_ADDRESS):
            return _identify_user(connection.pid)
    return None


def find_tcp_clients(host: str, port: int) -> tuple[PortUser, ...]:
    """Find other local processes connected to a TCP port, local or remote."""
    try:
        there = (socket.gethostbyname(host), port)
    except OSError:
        return ()
    return tuple(
        _identify_user(connection.pid) if connection.pid else PortUser(0, "a program of another user")
        for connection in psutil.net_connections(kind="tcp4")
        if connection.status == psutil.CONN_ESTABLISHED
        and connection.raddr == there
        and connection.pid != os.getpid()
    )


def find_udp_clients(address: str, port: int) -> tuple[PortUser, ...]:
    """Find other local processes that exchange datagrams with one UDP port, as far as this user can see."""
    return tuple(
        _identify_user(connection.pid)
        for connection in psutil.net_connections(kind="udp4")
        if connection.raddr == (address, port) and connection.pid not in (None, os.getpid())
    )


def find_lock_holder(file: int) -> PortUser | None:
    """Find the process holding the `flock` on an open file, with its terminal, or return None if hidden.

    psutil does not know locks.
    """
    inode = os.fstat(file).st_ino
    with contextlib.suppress(OSError, ValueError):
        for line in Path("/proc/locks").read_text().splitlines():
            _number, kind, *others = line.split()
            if kind == "FLOCK" and others[-3].endswith(f":{inode}"):
                pid = int(others[2])
                terminal = ""
                with contextlib.suppress(psutil.Error):
                    terminal = psutil.Process(pid).terminal() or ""
                return PortUser(pid, _describe_process(pid), terminal)
    return None


def find_folder_holder(folder: Path) -> PortUser | None:
    """Return the program that has a folder locked, or None, also for one that this user may not open."""
    with contextlib.suppress(OSError):
        file = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
        try:
            return find_lock_holder(file)
        finally:
            os.close(file)
    return None


def _open_devices(pid: int) -> Iterator[Path]:
    """List a process's open devices from /proc, since psutil's `open_files` omits them."""
    with contextlib.suppress(OSError):
        for file in Path(f"/proc/{pid}/fd").iterdir():
            with contextlib.suppress(OSError):
                if os.readlink(file).startswith("/dev/"):
                    yield file


def _is_device(file: Path, device: int) -> bool:
    with contextlib.suppress(OSError):
        return file.stat().st_rdev == device
    return False


def _is_master_of(file: Path, device: int) -> bool:
    """Return whether a process has the master side of the pseudo-terminal `device` open."""
    if not _FIRST_MAJOR <= os.major(device) <= _LAST_MAJOR:
        return False
    index = (os.major(device) - _FIRST_MAJOR) * 256 + os.minor(device)
    with contextlib.suppress(OSError):
        if os.path.basename(os.readlink(file)) == MASTER_NAME:
            state = (file.parent.parent / "fdinfo" / file.name).read_text()
            return f"{_INDEX}\t{index}" in state.splitlines()
    return False


def _identify_user(pid: int) -> PortUser:
    """Return the program that a process belongs to: the one that started it, if it only serves that one."""
    with contextlib.suppress(psutil.Error):
        process = psutil.Process(pid)
        while process.cmdline()[1:3] == OF_OURS:
            if (starter := process.parent()) is None or not _is_python(starter.cmdline()):
                break
            process = starter
            pid = process.pid
    return PortUser(pid, _describe_process(pid))


def _is_python(words: Sequence[str]) -> bool:
    return os.path.basename(words[0] if words else "").startswith("python")


def _describe_process(pid: int) -> str:
    with contextlib.suppress(psutil.Error):
        process = psutil.Process(pid)
        words = [word for word in process.cmdline() if word]
        if _is_python(words) and words[1:] and not words[1].startswith("-"):  # the program it runs says more
            words = [os.path.basename(words[1]), *words[2:]]
        line = " ".join(words) or process.name()
        return line if len(line) <= LONGEST_NAME else line[: LONGEST_NAME - 1] + "…"
    return "a program"


def describe_permissions(path: str) -> str:
    """Return the mode, owner and group of a port in `ls -l` format."""
    try:
        status = os.stat(path)
    except OSError as error:
        return str(error.strerror)
    return f"{stat.filemode(status.st_mode)} {_owner(status.st_uid)} {_group(status.st_gid)}"


def advise_on_permission(path: str) -> str:
    """Explain who may use a port and how to obtain permission."""
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
