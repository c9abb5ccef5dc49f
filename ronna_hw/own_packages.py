"""Notices a foreign package that bears one of our names.

`sim`, `drivers` and `procedures` are common words: another project on the path may have a package of
that name. Then half of the program would be somebody else's, so it must not start.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from ronna_hw.errors import ConfigurationError

OWN_PACKAGES = ("drivers", "sim", "procedures")


class ForeignPackage(ConfigurationError):
    """A package of ours is shadowed by another one on the path."""

    code = "CFG-003"
    action = "Run in an environment of its own, and not from a folder with a package of that name."


def foreign_packages() -> tuple[str, ...]:
    """Our package names that Python would load from somewhere else than beside `ronna_hw`."""
    home = Path(__file__).resolve().parent.parent
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
    """Raise CFG-003 when a foreign package would be loaded under one of our names."""
    foreign = foreign_packages()
    if foreign:
        raise ForeignPackage(f"another package is found under the name {' and '.join(foreign)}")
