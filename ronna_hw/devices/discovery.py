"""Devices found by a driver on this computer's lines and networks, as theatre file entries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from pydantic import BaseModel

from ronna_hw.devices.probing import Progress
from ronna_hw.endpoints import Endpoint
from ronna_hw.host.network_interfaces import Interface

ONLY = ""  # role of the endpoint of a device with only one


@dataclass(frozen=True)
class Search:
    """Where to search. Nothing is sent to any other line, network or address."""

    interfaces: tuple[Interface, ...] = ()
    lines: tuple[Endpoint, ...] = ()  # of trackers, serial or TCP
    controllers: tuple[Endpoint, ...] = ()  # of robots; without any, the networks of `interfaces`
    stream: Endpoint | None = None  # where a robot's telegrams should arrive, if already decided


@dataclass(frozen=True)
class Option:
    """One option of a driver: its value if it differs from the default, and its purpose."""

    key: str
    value: Any  # as in TOML; None if it has no default
    chosen: bool
    meaning: str
    model: type[BaseModel] | None = None  # of all options of that driver, for validating a value


@dataclass(frozen=True)
class Proposal:
    """A device as a theatre file entry."""

    driver: str
    what: str  # what was found, in words; empty for an example
    endpoints: Mapping[str, str]
    options: tuple[Option, ...] = ()
    remarks: tuple[str, ...] = ()  # what a person should check or complete
    absent: str = ""  # why there is no such device at the given address, if there is none


@runtime_checkable
class Finder(Protocol):
    """A probe that can also search. `table` is the theatre file's: `tracker`, `robot` or `stereo`."""

    table: str

    def find(self, search: Search, progress: Progress) -> Sequence[Proposal]:
        """Everything that answers as such a device, and the reason for each given address that does not.

        Nothing moves and no setting is changed.
        """
        ...

    def example(self, search: Search) -> Proposal:
        """An example of the table, for a device that was not found; its addresses are invented."""
        ...


def documented_options(model: type[BaseModel], chosen: Mapping[str, Any]) -> tuple[Option, ...]:
    """Every option of a driver with its description, including the values of the chosen ones."""
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
