"""Faults that grow evenly in theatre time: how far they have come, and what is still to come."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from sim.world.faults.fault import Fault
from sim.world.faults.room import SLOWLY

DIGITS = 9  # after the point, of mm, deg, N and s


def come_to(fault: Fault, onset_s: float, now_s: float) -> Fault:
    """Return a slow fault as the plain one that it has come to by now, and any other as it is."""
    plain = SLOWLY.get(fault.kind)
    if plain is None:
        return fault
    *amounts, duration_s = fault.arguments
    share = _share(float(duration_s), onset_s, now_s)
    return replace(fault, kind=plain, arguments=_scale(amounts, share))


def still_to_come(fault: Fault, onset_s: float, now_s: float) -> Fault | None:
    """Return the rest of a slow fault, as one that begins now, or None if nothing is left of it."""
    if fault.kind not in SLOWLY:
        return None
    *amounts, duration_s = fault.arguments
    share = _share(float(duration_s), onset_s, now_s)
    if share >= 1.0:
        return None
    rest_s = (1.0 - share) * float(duration_s)
    return replace(fault, arguments=(*_scale(amounts, 1.0 - share), f"{rest_s:.{DIGITS}f}"))


def _share(duration_s: float, onset_s: float, now_s: float) -> float:
    return min(1.0, (now_s - onset_s) / duration_s) if duration_s > 0.0 else 1.0


def _scale(amounts: Iterable[str], share: float) -> tuple[str, ...]:
    return tuple(
        f"{share * float(one):.{DIGITS}f}" if one.lstrip("+-")[:1].isdigit() else one for one in amounts
    )
