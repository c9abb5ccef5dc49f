"""Identity of this software: version, checkout commit, and package lock.

A result can only be recomputed with the packages that computed it, so each run records the hash of the lock
file and the names of packages installed in other versions.
"""

from __future__ import annotations

import hashlib
import re
import subprocess
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path

PACKAGE = "ronna-hw"
CHECKOUT = Path(__file__).resolve().parents[1]
LOCK = Path("requirements") / "locked.txt"
GIT_LIMIT_S = 2.0  # host time; a network folder may be slow, and a run does not wait for it
SHORT_HASH = 12  # characters: enough to tell locks apart at a glance
_VERSION = re.compile(r"^Version: *(.+)", re.MULTILINE)
_PINNED = re.compile(r"^(?P<name>[A-Za-z0-9._-]+)==(?P<version>[^\s;\\]+)", re.MULTILINE)


@dataclass(frozen=True)
class Software:
    """Software that computed a result.

    `commit` and `lock_sha256` are None if it does not run from a checkout.
    """

    version: str
    commit: str | None  # with "-dirty" if files differ from it
    lock_sha256: str | None
    otherwise: tuple[str, ...] = ()  # installed in another version than locked: "numpy 2.1, locked 2.0"

    def as_plain(self) -> dict[str, str | list[str] | None]:
        """Return plain values for a journal or a log."""
        return asdict(self) | {"otherwise": list(self.otherwise)}

    def __str__(self) -> str:
        commit = f" ({self.commit})" if self.commit else ""
        if self.lock_sha256 is None:
            return f"{PACKAGE} {self.version}{commit}, packages not locked"
        lock = f"lock {self.lock_sha256[:SHORT_HASH]}"
        return "; ".join((f"{PACKAGE} {self.version}{commit}, {lock}", *self.otherwise))


def identify_software(checkout: Path = CHECKOUT) -> Software:
    """Identify the running software, as installed and as checked out in a folder."""
    try:
        version = metadata.version(PACKAGE)
    except metadata.PackageNotFoundError:  # on the path without being installed
        version = "not installed"
    lock = checkout / LOCK
    if not lock.is_file():
        return Software(version, None, None)
    content = lock.read_bytes()
    return Software(
        version,
        _read_commit(checkout),
        hashlib.sha256(content).hexdigest(),
        tuple(_find_differing_packages(content.decode())),
    )


def _read_commit(checkout: Path) -> str | None:
    """Read the git commit, or return None without git or if the folder is not its own checkout."""
    if not (checkout / ".git").exists():
        return None
    try:
        completed = subprocess.run(
            ["git", "-C", str(checkout), "describe", "--always", "--dirty", "--abbrev=12"],
            capture_output=True,
            text=True,
            timeout=GIT_LIMIT_S,
            start_new_session=True,  # Ctrl-C is not for it
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return completed.stdout.strip() or None


def _find_differing_packages(lock: str) -> list[str]:
    """List locked packages whose installed version differs; missing packages are not needed here."""
    locked: dict[str, set[str]] = {}  # several versions of one package, for different versions of Python
    for match in _PINNED.finditer(lock):
        locked.setdefault(match["name"], set()).add(match["version"])
    found = []
    for name, versions in locked.items():
        try:
            installed = _read_version(metadata.distribution(name))
        except metadata.PackageNotFoundError:
            continue
        if installed not in versions:
            found.append(f"{name} {installed}, locked {' or '.join(sorted(versions))}")
    return found


def _read_version(package: metadata.Distribution) -> str:
    """Read a package's version from its metadata without parsing them, as `metadata.version` does."""
    found = _VERSION.search(package.read_text("METADATA") or "")
    return found[1] if found else package.version
