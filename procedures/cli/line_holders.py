"""Who else has a serial port open, or a UDP port of this computer, as far as this user may see."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

PROCESSES = Path("/proc")
LONGEST_NAME = 60  # characters of a command line that are shown
MASTER_NAME = "ptmx"  # the device of the far end of every pseudo-terminal
_INDEX = "tty-index:"
_FIRST_MAJOR, _LAST_MAJOR = 136, 143  # of pseudo-terminals on Linux, 256 to each


@dataclass(frozen=True)
class Holder:
    """A process that has the port open."""

    pid: int
    name: str

    def __str__(self) -> str:
        return f"{self.name} (pid {self.pid})"


def holders_of(path: str) -> tuple[Holder, ...]:
    """Other processes that have this port open; without the one at the far end of a pseudo-terminal.

    Processes of other users stay hidden, unless this one may see them. Empty where there is no /proc.
    """
    try:
        device = os.stat(path).st_rdev
    except OSError:
        return ()
    found = []
    for pid, links in _open_files():
        if pid == os.getpid() or not any(_is_device(file, device) for file, _ in links):
            continue
        if not any(_is_far_end(file, link, device) for file, link in links):
            found.append(Holder(pid, _name(pid)))
    return tuple(sorted(found, key=lambda holder: holder.pid))


def holder_of_udp_port(address: str, port: int) -> Holder | None:
    """The process on this computer that has a UDP port; None for another computer's, or an unseen one."""
    with contextlib.suppress(OSError):
        for line in (PROCESSES / "net" / "udp").read_text().splitlines()[1:]:
            fields = line.split()
            own, own_port = fields[1].split(":")
            bound = socket.inet_ntoa(bytes.fromhex(own)[::-1])
            if int(own_port, 16) != port or bound not in (address, "0.0.0.0"):
                continue
            link = f"socket:[{fields[9]}]"
            for pid, links in _open_files("socket:"):
                if any(name == link for _, name in links):
                    return Holder(pid, _name(pid))
    return None


def _open_files(prefix: str = "/dev/") -> Iterator[tuple[int, list[tuple[Path, str]]]]:
    """(process, its open devices or sockets as path below /proc and name)."""
    with contextlib.suppress(OSError):
        for entry in PROCESSES.iterdir():
            if not entry.name.isdigit():
                continue
            links = []
            with contextlib.suppress(OSError):
                for file in (entry / "fd").iterdir():
                    with contextlib.suppress(OSError):
                        link = os.readlink(file)
                        if link.startswith(prefix):
                            links.append((file, link))
            yield int(entry.name), links


def _is_device(file: Path, device: int) -> bool:
    with contextlib.suppress(OSError):
        return os.stat(file).st_rdev == device
    return False


def _is_far_end(file: Path, link: str, device: int) -> bool:
    if os.path.basename(link) != MASTER_NAME:
        return False
    if not _FIRST_MAJOR <= os.major(device) <= _LAST_MAJOR:
        return False
    index = (os.major(device) - _FIRST_MAJOR) * 256 + os.minor(device)
    with contextlib.suppress(OSError):
        told = (file.parent.parent / "fdinfo" / file.name).read_text()
        for line in told.splitlines():
            if line.startswith(_INDEX):
                return int(line.removeprefix(_INDEX)) == index
    return False


def _name(pid: int) -> str:
    with contextlib.suppress(OSError):
        words = (PROCESSES / str(pid) / "cmdline").read_bytes().split(b"\0")
        line = b" ".join(word for word in words if word).decode("utf-8", "replace")
        if line:
            return line if len(line) <= LONGEST_NAME else line[: LONGEST_NAME - 1] + "…"
    with contextlib.suppress(OSError):
        return (PROCESSES / str(pid) / "comm").read_text().strip()
    return "a program"
