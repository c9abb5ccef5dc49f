"""Register of this user's running simulators: one file each, locked while the simulator lives.

The files hold the control tokens, so folder and files are readable by this user only. A file that nobody has
locked belongs to a program that was killed; whoever finds it removes it.
"""

from __future__ import annotations

import atexit
import fcntl
import json
import os
import pwd
import shlex
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from stat import S_ISDIR, S_ISREG, filemode
from typing import Any

from ronna_hw.bounded_input import parse_json, read_bounded
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.errors import RonnaError
from ronna_hw.text import printable
from sim.errors import NOT_RUNNING, RegisterNotOwn

OWNER_ONLY = 0o700
LARGEST_ENTRY_BYTES = 64 * 1024  # one has 2
ENTRY = ".json"
LOG = ".log"
STARTING = ".starting"


@dataclass(frozen=True)
class RunningSimulator:
    """A running simulator, as registered by itself."""

    name: str  # of a theatre its run's or its folder's, else the device's
    pid: int
    in_background: bool
    folder: Path | None  # of a theatre
    ready: Mapping[str, Any]  # fields of its READY line
    name_is_unique: bool = True  # among those listed with it

    @property
    def log(self) -> Path:
        """File that receives the messages of a simulator in the background."""
        return register_folder() / f"{self.pid}{LOG}"

    @property
    def argument(self) -> str:
        """Shortest argument that means this simulator, quoted for a shell."""
        return shlex.quote(self.name) if self.name_is_unique else str(self.pid)

    @property
    def is_alive(self) -> bool:
        """Whether the simulator still holds its entry."""
        with suppress(OSError):
            return _is_held(register_folder() / f"{self.pid}{ENTRY}")
        return False

    def shell_lines(self) -> Iterator[str]:
        """Yield one quoted `export` line per variable, for `eval`."""
        return (f"export {name}={shlex.quote(value)}" for name, value in variables_of(self.ready).items())


OF_AN_ARM = ("CONTROLLER", "STREAM", "ARM")
OF_THE_ASSISTANT = tuple(f"ASSISTANT_{name}" for name in OF_AN_ARM)
VARIABLES = ("RONNA_CONTROL", "THEATRE", "LINE", *OF_AN_ARM, *OF_THE_ASSISTANT, "LEFT", "RIGHT", "CLOCK")
NO_VARIABLES = f"unset {' '.join(VARIABLES)}; false"  # for `eval`, which fails, and leaves none of another


def variables_of(ready: Mapping[str, Any]) -> dict[str, str]:
    """Return shell variables with the endpoints of a READY line, under the names that the pages use."""
    endpoints = ready.get("endpoints", {})
    basler = endpoints.get("basler", endpoints)
    master = endpoints.get("ur") or endpoints.get("kuka", endpoints)
    found = {
        "RONNA_CONTROL": ready.get("control", endpoints.get("control")),
        "THEATRE": ready.get("file"),
        "LINE": ready.get("endpoint", endpoints.get("polaris")),
        **dict(zip(OF_AN_ARM, _addresses_of(master), strict=True)),
        **dict(zip(OF_THE_ASSISTANT, _addresses_of(endpoints.get("assistant", {})), strict=True)),
        "LEFT": basler.get("left") and parse_endpoint(basler["left"]).host,
        "RIGHT": basler.get("right") and parse_endpoint(basler["right"]).host,
        "CLOCK": endpoints.get("clock"),
    }
    return {name: value for name, value in found.items() if value}


def _addresses_of(arm: Mapping[str, Any]) -> tuple[str | None, ...]:
    """Return controller and stream of a KUKA arm, and the host of a Universal Robots arm."""
    rtde = arm.get("rtde")
    return arm.get("eki_project"), arm.get("rsi"), rtde and parse_endpoint(rtde).host


def register(ready: Mapping[str, Any], *, in_background: bool, run: str = "") -> None:
    """Register this process until it ends; one in the foreground may lack a folder for that.

    `run` is the name of the run that the theatre belongs to: all their folders have the same name.
    """
    folder = Path(ready["file"]).parent if "file" in ready else None
    with nullcontext() if in_background else suppress(OSError, RegisterNotOwn):
        path = register_folder() / f"{os.getpid()}{ENTRY}"
        entry = {
            "name": run or (str(ready["device"]) if folder is None else folder.name),
            "in_background": in_background,
            "folder": None if folder is None else str(folder),
            "ready": dict(ready),
        }
        temporary = path.with_suffix(STARTING)
        file = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o600)
        fcntl.flock(file, fcntl.LOCK_EX)  # held, and the file open, as long as this process lives
        os.write(file, json.dumps(entry).encode())
        temporary.replace(path)
        atexit.register(path.unlink, missing_ok=True)


def register_folder() -> Path:
    """Return the register's folder. Raises SIM-019 unless it is a folder of this user alone."""
    runtime = os.environ.get("XDG_RUNTIME_DIR", "")
    if Path(runtime).is_absolute() and os.access(runtime, os.W_OK):
        folder = Path(runtime) / "ronna-sim"
    else:
        folder = Path(tempfile.gettempdir()) / f"ronna-sim-{os.getuid()}"
    try:
        with suppress(FileExistsError):
            folder.mkdir(mode=OWNER_ONLY)
        found = folder.lstat()
    except OSError as error:
        raise RegisterNotOwn(
            f"the register {printable(str(folder))} cannot be made: {error.strerror}"
        ) from error
    if found.st_uid != os.getuid() or not S_ISDIR(found.st_mode) or found.st_mode & 0o077:
        raise RegisterNotOwn(
            f"the register of running simulators cannot be {printable(str(folder))}",
            expected=f"a folder of {_account(os.getuid())} alone (mode 700)",
            got=f"{filemode(found.st_mode)}, owned by {_account(found.st_uid)}",
        )
    return folder


def _account(number: int) -> str:
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:  # as in a container
        return f"uid {number}"


def list_running() -> tuple[RunningSimulator, ...]:
    """List this user's running simulators by name, and remove entries of those that were killed."""
    return read_register()[0]


def read_register() -> tuple[tuple[RunningSimulator, ...], tuple[Path, ...]]:
    """Return what `list_running` does, and the files that are no entries: these are skipped and stay."""
    found, bad = [], []
    for path in sorted(register_folder().glob(f"*{ENTRY}")):
        try:
            if _is_held(path):
                found.append(_parse_entry(path))
            else:
                path.unlink(missing_ok=True)
        except (OSError, RonnaError, ValueError, LookupError, TypeError, AttributeError):
            if os.path.lexists(path):  # else it ended meanwhile
                bad.append(path)
    count = Counter(one.name for one in found)
    found = [replace(one, name_is_unique=count[one.name] == 1) for one in found]
    return tuple(sorted(found, key=lambda one: (one.name, one.pid))), tuple(bad)


def _parse_entry(path: Path) -> RunningSimulator:
    """Read an entry; raises many errors if it is none."""
    entry: Any = parse_json(read_bounded(path, LARGEST_ENTRY_BYTES))
    folder = None if entry["folder"] is None else Path(entry["folder"])
    ready = dict(entry["ready"])
    named = (
        entry["name"],
        ready["device"],
        *variables_of(ready).values(),
        *([ready["file"]] if folder else []),
    )
    if not all(isinstance(text, str) for text in named):
        raise ValueError("a name or an endpoint is no text")
    return RunningSimulator(entry["name"], int(path.stem), bool(entry["in_background"]), folder, ready)


def _is_held(path: Path) -> bool:
    """Return whether a process holds this file. Raises OSError if it is no regular file, or is gone."""
    file = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK | os.O_NOFOLLOW)  # a pipe has no writer
    try:
        if not S_ISREG(os.fstat(file).st_mode):
            raise OSError(f"{path} is no regular file")
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(file)
    return False


def find_running(cell: str | None) -> RunningSimulator:
    """Resolve a simulator by name, process number, or theatre folder or file; without `cell` the only one.

    Raises SIM-018 listing those that run, unless it is exactly one.
    """
    running = list_running()
    chosen = running if cell is None else tuple(one for one in running if _is_meant(one, cell))
    here = [one for one in chosen if one.folder is not None and one.folder.is_relative_to(Path.cwd())]
    named = [one for one in here if cell is not None and one.folder == Path(cell).resolve()]
    for only in (chosen, named, here):  # names repeat: the one in this folder goes first
        if len(only) == 1:
            return only[0]
    listed = ", ".join(f"{one.name} (pid {one.pid}{_place(one)})" for one in chosen or running) or "none"
    if not chosen:
        what = "no simulator is running" if cell is None else f"no simulator {cell!r} is running"
        start = None if running else "Start one, such as ronna-sim theatre --scene mini --out cell --detach."
        raise NOT_RUNNING(what, expected="one that is running", got=listed, action=start)
    what = "several simulators are running" if cell is None else f"several simulators are named {cell!r}"
    action = "Give its name." if cell is None else "Give its process number, or a theatre's folder."
    raise NOT_RUNNING(what, expected="one of them", got=listed, action=action)


def _is_meant(one: RunningSimulator, cell: str) -> bool:
    if cell in (one.name, str(one.pid)):
        return True
    place = Path(cell).resolve()
    return one.folder is not None and place in (one.folder, Path(str(one.ready["file"])))


def _place(one: RunningSimulator) -> str:
    return "" if one.folder is None else f", {one.folder}"
