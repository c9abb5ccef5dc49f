"""Recipes of RTDE, compiled once when a client sets them up.

An output recipe packs its places of the variables with one call; an input recipe stores runs of fields that
lie side by side with one assignment each.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import itemgetter
from struct import Struct
from typing import Any

from ronna_hw.wire.universal_robots import INPUTS, OUTPUTS, RTDE_HEADER, FieldType, PackageType
from sim.universal_robots.variables import PLACES, indices

# Inputs with an effect beyond being stored: value and the mask that says whether it counts.
ACTING = frozenset(name for name in INPUTS if "register" not in name and name != "external_force_torque")


def field_list(text: bytes) -> list[str]:
    """Split a list of names; one client ends it with a comma."""
    names = text.decode("ascii", "replace").split(",")
    return names[:-1] if names and not names[-1] else names


class OutputRecipe:
    """Output package of one client."""

    def __init__(self, number: int, names: Sequence[str], divider: int, *, with_number: bool) -> None:
        self.names = tuple(names)
        self.divider = divider  # it is sent every so many cycles
        codes = "".join(OUTPUTS[name].codes for name in names)
        head = ">HBB" if with_number else RTDE_HEADER
        self._layout = Struct(head + codes)
        places = indices(names)
        pick = itemgetter(*places) if len(places) > 1 else lambda values: (values[places[0]],)
        start = (self._layout.size, PackageType.DATA.value, *((number,) if with_number else ()))
        self.pack = _packer(self._layout.pack, start, pick)


def _packer(
    pack: Callable[..., bytes], start: tuple[int, ...], pick: Callable[[Sequence[Any]], tuple[Any, ...]]
) -> Callable[[Sequence[Any]], bytes]:
    if len(start) == 3:
        size, kind, number = start
        return lambda values: pack(size, kind, number, *pick(values))
    size, kind = start
    return lambda values: pack(size, kind, *pick(values))


class InputRecipe:
    """Input package of one client."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(names)
        self.acts = not ACTING.isdisjoint(names)
        self._layout = Struct(">" + "".join(INPUTS[name].codes for name in names))
        self.size_bytes = self._layout.size
        self._runs = _list_runs(names)

    def store(self, payload: bytes, values: list[Any]) -> None:
        """Store the fields of a package that is long enough."""
        fields = self._layout.unpack_from(payload, 1)
        for place, part in self._runs:
            values[place] = fields[part]

    def writes(self, place: int) -> bool:
        """Whether a package writes this place of the variables."""
        return any(run.start <= place < run.stop for run, _ in self._runs)

    def acting(self, payload: bytes) -> dict[str, Any]:
        """Return the fields by name, all of them scalar or unused."""
        fields, found, start = self._layout.unpack_from(payload, 1), {}, 0
        for name in self.names:
            found[name] = fields[start]
            start += PLACES[name].stop - PLACES[name].start
        return found


def _list_runs(names: Sequence[str]) -> tuple[tuple[slice, slice], ...]:
    runs: list[tuple[slice, slice]] = []
    start = 0
    for name in names:
        place = PLACES[name]
        end = start + place.stop - place.start
        if runs and runs[-1][0].stop == place.start:
            runs[-1] = (slice(runs[-1][0].start, place.stop), slice(runs[-1][1].start, end))
        else:
            runs.append((place, slice(start, end)))
        start = end
    return tuple(runs)


def type_names(names: Sequence[str], known: dict[str, FieldType]) -> list[str]:
    """Return the type of each field as on the wire."""
    return [known[name].name if name in known else "NOT_FOUND" for name in names]
