"""Measuring settings: the selected volume and the illuminator rate."""

from __future__ import annotations

from drivers.ndi_polaris.errors import MalformedReply, UnitError
from drivers.ndi_polaris.line.command_link import CommandLink
from drivers.ndi_polaris.unit.measuring_volume import MeasuringVolume, parse_volumes
from drivers.ndi_polaris.unit.user_parameters import read_parameter, whole_number
from ronna_hw.wire.polaris import (
    ILLUMINATOR_RATES_HZ,
    PARAMETER_ILLUMINATOR_RATE,
    PARAMETER_SELECTED_VOLUME,
    SFLIST_VOLUMES,
)

SFLIST_BYTES = 1024  # room for nine volumes of 74 characters each


def choose_volume(link: CommandLink, wanted: int | None, deadline_s: float) -> MeasuringVolume | None:
    """Select volume `wanted` (from 1) if given; returns the volume in use, None if unknown."""
    if wanted is not None:
        link.ask("VSEL", f"{wanted}", deadline_s=deadline_s)
    try:
        volumes = parse_volumes(
            link.ask("SFLIST", SFLIST_VOLUMES, deadline_s=deadline_s, reply_bytes=SFLIST_BYTES)
        )
    except (UnitError, MalformedReply):
        return None
    index = wanted - 1 if wanted is not None else _selected(link, deadline_s)
    return volumes[index] if 0 <= index < len(volumes) else None


def _selected(link: CommandLink, deadline_s: float) -> int:
    try:
        return whole_number(read_parameter(link, PARAMETER_SELECTED_VOLUME, deadline_s)) or 0
    except UnitError:
        return 0


def set_illuminator_rate(link: CommandLink, rate_hz: int, deadline_s: float) -> int:
    """Set the rate by SET, or IRATE on older firmware; returns the rate in use, Hz."""
    code = next(code for code, rate in ILLUMINATOR_RATES_HZ.items() if rate == rate_hz)
    for name, argument in (("SET", f"{PARAMETER_ILLUMINATOR_RATE}={code}"), ("IRATE", f"{code}")):
        try:
            link.ask(name, argument, deadline_s=deadline_s)
        except UnitError:
            continue
        return rate_hz
    try:
        kept = whole_number(read_parameter(link, PARAMETER_ILLUMINATOR_RATE, deadline_s))
    except UnitError:
        kept = None
    return ILLUMINATOR_RATES_HZ.get(kept or 0, min(ILLUMINATOR_RATES_HZ.values()))
