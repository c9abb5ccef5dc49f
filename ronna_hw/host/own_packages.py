"""Detects a foreign package with the name of one of ours.

`sim`, `drivers` and `procedures` are common names: if another project on the path shadows one of them, half
of the program is foreign code, so it must not start.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from ronna_hw.errors import ConfigurationError

OWN_PACKAGES = ("conformance", "drivers", "sim", "procedures", "studies")


class ForeignPackage(ConfigurationError):
    """One of our packages is shadowed by another of the same name on the path."""

    code = "CFG-003"
    action = "Use a separate virtual environment, and do not run from a folder that contains such a package."


def foreign_packages() -> tuple[str, ...]:
    """Those of our package names that Python would not load from the folder of `ronna_hw`."""
    home = Path(__file__).resolve().parents[2]
    foreign = []
    for name in OWN_PACKAGES:
        spec = find_spec(name)
        places = (
            [] if spec is None else [Path(place).resolve() for place in spec.submodule_search_locations or ()]
        )
        if places != [home / name]:
            foreign.append(name)
    return tuple(foreign)


def require_own_packages() -> None:
    """Raise CFG-003 when one of our names would load a foreign package."""
    foreign = foreign_packages()
    if foreign:
        raise ForeignPackage(f"another package on the path is named {' and '.join(foreign)}")
