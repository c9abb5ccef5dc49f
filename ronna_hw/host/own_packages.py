"""Detect foreign or overwritten packages on the import path.

Their names are common: a program's own `sim.py`, or another distribution with a package `console`, may stand
before them on the path. A wheel shares site-packages with others, and installers overwrite files of equal
names without a word.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from ronna_hw.errors import ConfigurationError, summary_of

OWN_PACKAGES = ("conformance", "console", "drivers", "procedures", "sim", "studies")
DISTRIBUTION = "ronna-hw"
LISTED_FILES = 3


class ForeignPackage(ConfigurationError):
    """Another module of the same name stands before one of our packages, or has replaced files of it."""

    code = "CFG-003"
    action = (
        "Rename that file or folder, start the command from another folder, or install ronna-hw in a virtual "
        "environment of its own."
    )


def require_own_packages(names: Sequence[str] = OWN_PACKAGES) -> None:
    """Raise CFG-003 if a package of these names would be loaded from elsewhere than beside `ronna_hw`."""
    if foreign := find_foreign_packages(names):
        raise ForeignPackage(
            "not ours, but first on the path: "
            + ", ".join(f"{name} ({place})" for name, place in foreign.items()),
            expected=f"those in {_home()}",
        )


def find_foreign_packages(names: Sequence[str] = OWN_PACKAGES) -> dict[str, str]:
    """Map our package names that Python would not load from the folder of `ronna_hw` to their places."""
    foreign = {}
    for name in names:
        try:
            spec = find_spec(name)
        except ValueError:  # already imported, from no file
            foreign[name] = "made by a program"
            continue
        if spec is None:
            foreign[name] = "missing"
            continue
        places = [Path(place).resolve() for place in spec.submodule_search_locations or ()]
        if places != [_home() / name]:
            foreign[name] = str(places[0] if places else spec.origin)
    return foreign


def find_replaced_files() -> tuple[str, ...]:
    """List our installed files that are missing or not as installed; none for an editable installation."""
    from importlib.metadata import PackageNotFoundError, distribution

    try:
        files = distribution(DISTRIBUTION).files or ()
    except PackageNotFoundError:
        return ()
    return tuple(
        str(file)
        for file in files
        if file.parts[0] in OWN_PACKAGES
        and file.hash is not None
        and _digest(Path(str(file.locate())), file.hash.mode) != file.hash.value
    )


def explain_failed_import(module: str, error: Exception) -> ForeignPackage | None:
    """Explain a failed import of ours by replaced files, or return None if there are none."""
    from importlib.metadata import packages_distributions

    if not (replaced := find_replaced_files()):
        return None
    more = f" and {len(replaced) - LISTED_FILES} more" if len(replaced) > LISTED_FILES else ""
    roots = {Path(one).parts[0] for one in replaced}
    sharing = {one for name in roots for one in packages_distributions().get(name, ())} - {DISTRIBUTION}
    return ForeignPackage(
        f"{module} cannot be imported: {summary_of(error)}",
        expected="our files as installed",
        got=f"replaced or missing: {', '.join(replaced[:LISTED_FILES])}{more}"
        + (f"; {', '.join(sorted(sharing))} has packages of the same names" if sharing else ""),
        action="Install ronna-hw again, in a virtual environment of its own.",
    )


def _home() -> Path:
    return Path(__file__).resolve().parents[2]


def _digest(file: Path, algorithm: str) -> str:
    """Return a file's digest as in a wheel's RECORD; empty if it cannot be read."""
    import base64
    import hashlib

    try:
        digest = hashlib.new(algorithm, file.read_bytes()).digest()
    except OSError:
        return ""
    return base64.urlsafe_b64encode(digest).rstrip(b"=").decode()
