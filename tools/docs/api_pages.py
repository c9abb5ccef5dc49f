"""Pages of the Python API: signatures and docstrings, as they stand in the modules.

A member without a docstring gets the docstring of its interface: drivers inherit nothing else.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any

import procedures.imaging
import procedures.registration
import procedures.relocalization
from drivers.basler_stereo import BaslerStereoPair
from drivers.kuka_rsi import KukaRsiArm
from drivers.ndi_polaris import PolarisTracker
from procedures.exchange import raw_readings
from procedures.strategies import strategy, trajectory
from ronna_hw import frames, theatre
from ronna_hw.devices import ConfirmedStart, OpticalTracker, RobotArm, StereoPair, lifecycle, readings, robot
from ronna_hw.devices.capabilities import RecordsBytes
from studies.plugins import contracts

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


@dataclass(frozen=True)
class Part:
    """Names of one module; for a driver, the interfaces whose docstrings it inherits."""

    module: str
    objects: Sequence[Any]
    interfaces: tuple[type, ...] = ()


def _of(module: Any, *names: str) -> Part:
    return Part(module.__name__, [getattr(module, name) for name in names or module.__all__])


def _driver(kind: type, interface: type) -> Part:
    return Part(kind.__module__.rpartition(".")[0], [kind], (interface, ConfirmedStart, RecordsBytes))


def numerics() -> str:
    """Registration, imaging, the stereo head, strategies, own methods, raw readings."""
    return _page(
        [
            _of(procedures.registration),
            _of(procedures.imaging),
            _of(procedures.relocalization),
            _of(strategy, "Strategy"),
            _of(trajectory, "Trajectory"),
            _of(contracts, "Localizer", "Pairing", "PairedRegistration", "StrategyFactory"),
            _of(raw_readings, "RawReading", "raw_readings", "write_raw"),
            _of(frames, "Frame", "Transform"),
        ]
    )


def devices() -> str:
    """The theatre that opens them, the interfaces of devices, their readings, and the drivers."""
    interfaces = Part(
        "ronna_hw.devices",
        [lifecycle.Device, OpticalTracker, RobotArm, robot.JointMove, robot.LineMove, StereoPair],
    )
    own = [
        one for one in vars(readings).values() if inspect.isclass(one) and one.__module__ == readings.__name__
    ]
    return _page(
        [
            _of(theatre, "open_theatre", "Theatre"),
            _of(theatre, "simulated_theatre"),
            interfaces,
            Part(readings.__name__, own),
            _driver(PolarisTracker, OpticalTracker),
            _driver(KukaRsiArm, RobotArm),
            _driver(BaslerStereoPair, StereoPair),
        ]
    )


def _page(parts: Sequence[Part]) -> str:
    return "\n".join(line for part in parts for line in _part(part)) + "\n"


def _part(part: Part) -> Iterator[str]:
    yield f"## `{part.module}`\n"
    for one in part.objects:
        if inspect.isclass(one):
            yield from _class(one, part.interfaces)
        else:
            yield f"### `{one.__name__}{_signature(one)}`\n\n{_words(one)}\n"


def _class(one: type, interfaces: tuple[type, ...]) -> Iterator[str]:
    yield f"### class `{one.__name__}`\n\n{_words(one)}\n"
    if issubclass(one, Enum):
        yield f"Members: {', '.join(f'`{name}`' for name in one.__members__)}.\n"
    elif is_dataclass(one):
        yield from _fields(one)
    if inspect.isfunction(call := vars(one).get("__call__")) and getattr(one, "_is_protocol", False):
        yield f"- **`{one.__name__}{_signature(call)}`**: {_on_one_line(_words(call))}"
    for name, member in _members(one).items():
        if name.startswith("_"):
            continue
        got = member.__func__ if isinstance(member, classmethod | staticmethod) else member
        spoken = (getattr(got, "fget", got), *(getattr(two, name, None) for two in interfaces))
        words = next((said for two in spoken if two is not None and (said := inspect.getdoc(two))), "")
        if isinstance(got, property):
            yield f"- **`{name}`**: {_on_one_line(words)}"
        elif inspect.isfunction(got):
            yield f"- **`{name}{_signature(got)}`**: {_on_one_line(words)}"
    yield ""


def _members(one: type) -> dict[str, Any]:
    """Members of a class; for a driver also the members of its base classes."""
    bases = [base for base in reversed(one.__mro__) if base is one or base.__module__.startswith("drivers.")]
    return {name: member for base in bases for name, member in vars(base).items()}


def _fields(one: type[DataclassInstance]) -> Iterator[str]:
    """Each field with its type and, where one stands beside it, its comment: mostly the unit."""
    lines = inspect.getsource(one).splitlines()
    for field in fields(one):
        if field.name.startswith("_"):
            continue
        written = next((line for line in lines if line.startswith(f"    {field.name}:")), "")
        comment = written.partition("  # ")[2]
        yield f"- `{field.name}`: `{field.type}`" + (f"; {comment}" if comment else "")
    yield ""


def _signature(function: Any) -> str:
    """Return the signature without `self` and types, which are in the module and the docstring."""
    given = inspect.signature(function)
    kept = [
        one.replace(annotation=one.empty, default=_default(one.default))
        for one in given.parameters.values()
        if one.name not in ("self", "cls")
    ]
    return str(given.replace(parameters=kept, return_annotation=given.empty))


def _default(value: Any) -> Any:
    return _Unsaid() if inspect.isfunction(value) else value


class _Unsaid:
    """Stands for a default that is a function; its docstring describes it."""

    def __repr__(self) -> str:
        return "..."


def _words(one: Any) -> str:
    return inspect.cleandoc(one.__doc__ or "")


def _on_one_line(words: str) -> str:
    return " ".join(words.split())
