"""Load on the flange as the controller takes it: payload, centre of gravity, tool centre point, in metres."""

from __future__ import annotations

from collections.abc import Sequence
from math import dist, isfinite

from drivers.universal_robots.errors import BAD_LOAD
from ronna_hw.devices.contact import ToolLoad
from ronna_hw.vectors import Vector3

LOAD_FIELDS = ("payload", "payload_cog", "tcp_offset")
MASS_ROUNDING_KG = 1e-4
PLACE_ROUNDING_MM = 1e-2
LARGEST_MASS_KG = 5.0  # of UR5 and UR5e
FARTHEST_MM = 1000.0
MM = 1000.0


def load_commands(load: ToolLoad | None, mass_kg: float | None = None) -> tuple[str, ...]:
    """Return the commands that set a load, or a mass alone; none if neither is given. Raises URD-041."""
    if load is None:
        return () if mass_kg is None else (f"set_payload({mass_kg:g})",)
    if not 0.0 <= load.mass_kg <= LARGEST_MASS_KG:
        raise BAD_LOAD("the mass of the tool", limit=f"{LARGEST_MASS_KG:g} kg", got=f"{load.mass_kg:g} kg")
    for place in (load.centre_mm, load.tip_mm):
        if not (all(map(isfinite, place)) and dist(place, (0.0, 0.0, 0.0)) <= FARTHEST_MM):
            raise BAD_LOAD("a place of the tool", limit=f"{FARTHEST_MM:g} mm from the flange", got=f"{place}")
    return (
        f"set_payload({load.mass_kg:g}, [{_metres(load.centre_mm)}])",
        f"set_tcp(p[{_metres(load.tip_mm)}, 0, 0, 0])",
    )


def to_load(values: Sequence[float]) -> ToolLoad:
    """Return the load in an output package of `LOAD_FIELDS`."""
    return ToolLoad(values[0], _millimetres(values[1:4]), _millimetres(values[4:7]))


def has_load(found: ToolLoad, wanted: ToolLoad | None, mass_kg: float | None) -> bool:
    """Return whether the controller uses the load that was set, or the mass if only that was."""
    if wanted is None:
        return mass_kg is None or abs(found.mass_kg - mass_kg) <= MASS_ROUNDING_KG
    return (
        abs(found.mass_kg - wanted.mass_kg) <= MASS_ROUNDING_KG
        and dist(found.centre_mm, wanted.centre_mm) <= PLACE_ROUNDING_MM
        and dist(found.tip_mm, wanted.tip_mm) <= PLACE_ROUNDING_MM
    )


def _metres(place_mm: Vector3) -> str:
    return ", ".join(f"{value / MM:g}" for value in place_mm)


def _millimetres(place_m: Sequence[float]) -> Vector3:
    x, y, z = place_m
    return x * MM, y * MM, z * MM
