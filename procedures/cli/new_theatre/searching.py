"""Device search, and selection among its results."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import TypeVar

from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.messages import tell
from ronna_hw.command_line.terminal import Progress
from ronna_hw.devices.probing import Finder, Proposal, Search
from ronna_hw.endpoints import BadEndpoint, Endpoint, parse_endpoint
from ronna_hw.host.network import Interface, interfaces
from ronna_hw.roles import ASSISTANT
from ronna_hw.text import format_count
from ronna_hw.wire.kuka_eki import PROJECT_PORT

A = TypeVar("A")
T = TypeVar("T")
ARM = "robot"  # table of the arms
Choose = Callable[[str, Sequence[str]], int | None]  # asks a person; None where there is none


@dataclass(frozen=True)
class DeviceTable:
    """Theatre file table of a device, either found or given as an example."""

    table: str
    proposal: Proposal
    is_found: bool


def find_interfaces(names: Iterable[str]) -> tuple[Interface, ...]:
    """Find network interfaces by name or address. Raises CLI-001 listing those available."""
    every = interfaces()
    chosen: list[Interface] = []
    for name in names:
        alike = [each for each in every if name in (each.name, each.address)]
        if not alike:
            known = ", ".join(f"{each.name} ({each.address})" for each in every)
            raise UsageMistake(
                f"--interface: this computer has no network interface {name}",
                expected=f"one of {known}",
                action="Give the card that the cameras are connected to.",
            )
        chosen += [each for each in alike if each not in chosen]
    return tuple(chosen)


def _controller(text: str) -> Endpoint:
    full = text if "://" in text else f"tcp://{text}"
    host = full.removeprefix("tcp://")
    return parse_endpoint(full if ":" in host else f"{full}:{PROJECT_PORT}").require("tcp")


_STREAM = (lambda text: parse_endpoint(text).require("udp"), "udp://HOST:PORT", "udp://192.168.10.20:59152")
_CONTROLLER = (_controller, "HOST or HOST:PORT", "172.31.1.147")
# Options that give an endpoint: how its text is read, its form in words, a fitting example.
ENDPOINT_OPTIONS: Mapping[str, tuple[Callable[[str], Endpoint], str, str]] = {
    "--stream": _STREAM,
    "--assistant-stream": _STREAM,
    "--clock": (
        lambda text: parse_endpoint(text).require("host", "shm"),
        "host: or shm:///PATH, as in the READY line of a simulated theatre",
        "host:",
    ),
    "--serial": (
        lambda text: parse_endpoint(f"serial://{text}" if text[:1] == "/" else text).require("serial", "tcp"),
        "the path of a line, or tcp://HOST:PORT",
        "/dev/ttyUSB0",
    ),
    "--controller": _CONTROLLER,
    "--assistant": _CONTROLLER,
}

CHOSEN_BY = {  # options that select among devices found, by table
    "stereo": "--left ADDRESS --right ADDRESS",
    "tracker": "--serial LINE",
    ARM: "--controller HOST:PORT",
}


def endpoint_of(option: str, text: str) -> Endpoint:
    """Parse an endpoint given as an option. Raises CLI-001 with the expected format and an example."""
    read, form, example = ENDPOINT_OPTIONS[option]
    try:
        return read(text)
    except BadEndpoint as error:
        action = f"For example: {option} {example}."
        raise UsageMistake(f"{option}: {error.what}", expected=form, action=action) from error


def require_another(option: str, of_master: Sequence[Endpoint], address: Endpoint) -> None:
    """Raise CLI-001 if another arm is given an address of the master."""
    if address in of_master:
        raise UsageMistake(
            f"{option} is {address}, which is given for the master as well",
            expected="addresses of its own for each arm",
            action=f"Give {option} the address of the assistant, or omit it.",
        )


def lines(given: Sequence[str] | None) -> Sequence[str]:
    """Return the serial lines to probe: those given, or else every serial port of this computer."""
    if given is not None:
        return given
    from serial.tools import list_ports

    return sorted(str(port.device) for port in list_ports.comports())


class Mistakes:
    """Collector of usage mistakes, so that all of them are reported at once at the end of the block."""

    def __init__(self) -> None:
        self._found: list[UsageMistake] = []

    def collect(self, read: Callable[[A], T], arguments: Iterable[A]) -> tuple[T, ...]:
        """Return what `read` makes of each argument, noting those that it refuses."""
        outcomes = []
        for argument in arguments:
            try:
                outcomes.append(read(argument))
            except UsageMistake as mistake:
                self._found.append(mistake)
        return tuple(outcomes)

    def __enter__(self) -> Mistakes:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Raise CLI-001 with every mistake, unless another error ends the block."""
        if kind is not None or not self._found:
            return
        if len(self._found) == 1:
            raise self._found[0]
        every = "; ".join(
            f"({number}) {one.what}" + (f", expected {one.expected}" if one.expected else "")
            for number, one in enumerate(self._found, start=1)
        )
        raise UsageMistake(
            f"{format_count(len(self._found), 'mistake')}: {every}", action="Correct them all."
        )


def example_tables(finders: Iterable[Finder], search: Search) -> tuple[DeviceTable, ...]:
    """Return the example table of each finder, with every option of its driver."""
    return tuple(DeviceTable(finder.table, finder.example(search), is_found=False) for finder in finders)


def search_all(
    finders: Iterable[Finder],
    search: Search,
    cameras: tuple[str | None, str | None],
    choose: Choose,
    progress: Progress,
) -> tuple[DeviceTable, ...]:
    """Run every finder and choose where several devices are found for a table. CLI-001 if nobody chooses.

    A table for which nothing is found has the example of its first finder, and what all of them searched.
    """
    each = sorted(finders, key=lambda finder: finder.table)
    found = []
    done = 0
    for table, of_table in groupby(each, key=lambda finder: finder.table):
        group = tuple(of_table)
        proposals: list[Proposal] = []
        for finder in group:

            def advance(share: float, before: int = done) -> None:
                progress((before + share) / len(each))

            proposals += finder.find(search, advance)
            done += 1
            progress(done / len(each))
        if table == "stereo":
            proposals = list(_select_pairs(proposals, cameras))
        connected = [one for one in proposals if not one.absent]
        chosen = _choose_proposal(table, connected, choose, cameras)
        if chosen is None:
            missing = proposals or [finder.example(search) for finder in group]
            absent = "; ".join(dict.fromkeys(one.absent for one in missing if one.absent))
            found.append(DeviceTable(table, replace(missing[0], absent=absent), is_found=False))
        else:
            found.append(DeviceTable(table, chosen, is_found=True))
    return tuple(found)


def find_assistant(
    finders: Iterable[Finder], search: Search, choose: Choose, progress: Progress
) -> tuple[DeviceTable, ...]:
    """Search for a second arm at the controller named for it."""
    arms = [finder for finder in finders if finder.table == ARM]
    return as_assistant(search_all(arms, search, (None, None), choose, progress))


def as_assistant(tables: Iterable[DeviceTable]) -> tuple[DeviceTable, ...]:
    """Return the tables of arms among these as those of an assistant."""
    return tuple(replace(one, table=f"{ARM}.{ASSISTANT}") for one in tables if one.table == ARM)


def _select_pairs(pairs: Sequence[Proposal], cameras: tuple[str | None, str | None]) -> Sequence[Proposal]:
    """Select pairs by their cameras' serial numbers or addresses. Raises CLI-001 if none match."""
    every = pairs
    for (side, other), wanted in zip((("left", "right"), ("right", "left")), cameras, strict=True):
        if wanted is None:
            continue
        before, pairs = pairs, [pair for pair in pairs if wanted in _camera_identity(pair, side)]
        if not pairs:
            if cameras[0] is not None and any(wanted in _camera_identity(pair, "left") for pair in before):
                raise UsageMistake(
                    f"--{side}: camera {wanted} is given for both sides",
                    expected="two cameras",
                    action="Give each side its own camera.",
                )
            if alike := next((pair for pair in every if wanted in _camera_identity(pair, other)), None):
                serial, _address = _camera_identity(alike, other)
                raise UsageMistake(
                    f"--{side}: {wanted} is the camera named {other} ({serial})",
                    expected=f"{_camera_identity(alike, side)[0]}, which is named {side}",
                    action="Swap --left and --right; if the names are wrong, omit both options and swap the "
                    "cameras in the file.",
                )
            if any(wanted in _camera_identity(pair, side) for pair in every):
                raise UsageMistake(
                    f"--{side}: camera {wanted} is of another owner or model than --{other} {cameras[0]}",
                    expected="both cameras of one head",
                    got="; ".join(f"{one.what} at {', '.join(one.endpoints.values())}" for one in before),
                    action=f"Add {CHOSEN_BY['stereo']} of one pair.",
                )
            known = sorted({" at ".join(_camera_identity(pair, side)) for pair in before})
            raise UsageMistake(
                f"--{side}: no camera {wanted} replied",
                expected=f"one of {', '.join(known)}" if known else "two cameras on the given interfaces",
                action="Name a camera that replies; for one that does not, check power, cable and subnet.",
            )
    return pairs


def _camera_identity(pair: Proposal, side: str) -> tuple[str, str]:
    serial = next(str(option.value) for option in pair.options if option.key == f"{side}_serial")
    return serial, parse_endpoint(pair.endpoints[side]).host


def _choose_proposal(
    table: str, proposals: Sequence[Proposal], choose: Choose, cameras: tuple[str | None, str | None]
) -> Proposal | None:
    if len(proposals) < 2:
        return next(iter(proposals), None)
    words = [f"{one.what} at {', '.join(one.endpoints.values())}" for one in proposals]
    number = choose(f"Which is [{table}]?", words)
    if number is not None:
        return proposals[number]
    if table == "stereo" and None not in cameras:  # both given, but not by addresses
        raise _ambiguous_serial_error(proposals)
    found = _list_cameras(proposals) if table == "stereo" else words
    for line in found:
        tell(line)
    raise UsageMistake(
        f"{len(found)} {'cameras' if table == 'stereo' else 'devices'} found for [{table}]",
        action=f"Add {CHOSEN_BY[table]}, as listed above.",
    )


def _ambiguous_serial_error(pairs: Sequence[Proposal]) -> UsageMistake:
    """Describe serial numbers that several cameras have, as those of simulated theatres do."""
    for pair in pairs:  # whose it is stands in its words
        tell(f"{pair.what} at {', '.join(pair.endpoints.values())}")
    places: dict[str, list[str]] = {}
    for serial, address in sorted(
        {_camera_identity(pair, side) for pair in pairs for side in pair.endpoints}
    ):
        places.setdefault(serial, []).append(address)
    shared = [
        f"serial number {serial} is at {len(addresses)} addresses: {', '.join(addresses)}"
        for serial, addresses in places.items()
        if len(addresses) > 1
    ]
    return UsageMistake(
        "; ".join(shared),
        expected="one camera for each side",
        action=f"Add {CHOSEN_BY['stereo']} of one of the pairs listed above, in place of serial numbers.",
    )


def _list_cameras(pairs: Sequence[Proposal]) -> list[str]:
    """List each camera of these pairs once, by address."""
    cameras = {_camera_identity(pair, side) for pair in pairs for side in ("left", "right")}
    by_address = sorted(cameras, key=lambda camera: camera[1])
    return [f"camera {serial} at {address}" for serial, address in by_address]
