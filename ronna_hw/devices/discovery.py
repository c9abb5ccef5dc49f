"""Devices that a driver finds on this computer's lines and networks, in the form of theatre file entries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from pydantic import BaseModel

from ronna_hw.devices.probing import Progress
from ronna_hw.endpoints import Endpoint
from ronna_hw.host.network_interfaces import Interface

ONLY = ""  # role of the endpoint of a device that has one


@dataclass(frozen=True)
class Search:
    """Where to look. Nothing is sent to any other line, network or address."""

    interfaces: tuple[Interface, ...] = ()
    lines: tuple[Endpoint, ...] = ()  # of trackers, serial or TCP
    controllers: tuple[Endpoint, ...] = ()  # of robots; without any, the networks of `interfaces`
    stream: Endpoint | None = None  # where a robot's telegrams are to arrive, where that is settled


@dataclass(frozen=True)
class Option:
    """One option of a driver: its value where it differs from the default, and what it is for."""

    key: str
    value: Any  # as TOML has it; None where it has no default
    chosen: bool
    meaning: str
    model: type[BaseModel] | None = None  # of all options of that driver, to check a value by


@dataclass(frozen=True)
class Proposal:
    """A device in the form of a theatre file entry."""

    driver: str
    what: str  # what was found, in words; empty for an example
    endpoints: Mapping[str, str]
    options: tuple[Option, ...] = ()
    remarks: tuple[str, ...] = ()  # what a person is to check or to complete
    absent: str = ""  # why no such device is at the address that was given, where that is so


@runtime_checkable
class Finder(Protocol):
    """A probe that can also search. `table` is that of the theatre file: `tracker`, `robot` or `stereo`."""

    table: str

    def find(self, search: Search, progress: Progress) -> Sequence[Proposal]:
        """Everything that answers as such a device, and where an address was given that does not, why.

        Nothing moves and no setting is changed.
        """
        ...

    def example(self, search: Search) -> Proposal:
        """What the table would look like, for a device that was not found; its addresses are made up."""
        ...


def documented_options(model: type[BaseModel], chosen: Mapping[str, Any]) -> tuple[Option, ...]:
    """Every option of a driver with its description, the chosen ones with their values."""
    return tuple(
        Option(
            name,
            chosen.get(name, None if field.is_required() else field.get_default(call_default_factory=True)),
            name in chosen,
            field.description or "",
            model,
        )
        for name, field in model.model_fields.items()
    )
