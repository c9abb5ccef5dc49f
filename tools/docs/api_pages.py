"""Python API pages, with signatures and docstrings extracted from the modules.

A member without a docstring gets that of its interface. What a driver inherits of a streamed arm is its own.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from typing import Any

from pydantic import BaseModel
from reference_tables import table

import procedures.imaging
import procedures.registration
import procedures.relocalization
from drivers.basler_stereo import BaslerStereoPair
from drivers.kuka_rsi import KukaRsiArm
from drivers.ndi_polaris import PolarisTracker
from drivers.universal_robots import UniversalRobotsArm
from procedures import from_python
from procedures.exchange import raw_readings, recorded_tables, registration_in_ct, run_tables
from procedures.reporting.comparison import page as page_of_two
from procedures.strategies import strategy, trajectory
from ronna_hw import frames, loaded_run, room_truth, simulated_room, theatre
from ronna_hw.devices import (
    ConfirmedStart,
    OpticalTracker,
    RobotArm,
    StereoPair,
    lifecycle,
    readings,
    robot,
    stray_tracks,
)
from ronna_hw.devices.axis_loads import TellsLoads
from ronna_hw.devices.capabilities import RecordsBytes
from ronna_hw.devices.contact import CarriesLoad, FollowsHand, InsertsInstruments, TellsFeed
from ronna_hw.devices.lifecycle import GuardedDevice
from studies import parameter_sweep
from studies.plugins import contracts

TRUTH = (
    "RoomTruth", "TrueSphere", "TrueMarker", "TruePhantom", "StrayOrigin", "Origin",
)  # fmt: skip


@dataclass(frozen=True)
class Part:
    """Documented objects of one module. For a driver, also the interfaces whose docstrings it inherits."""

    module: str
    objects: Sequence[Any]
    interfaces: tuple[type, ...] = ()


def _all_of(module: Any, *names: str) -> Part:
    return Part(module.__name__, [getattr(module, name) for name in names or module.__all__])


def _driver_part(kind: type, *interfaces: type) -> Part:
    return Part(kind.__module__.rpartition(".")[0], [kind], (*interfaces, ConfirmedStart, RecordsBytes))


def numerics() -> str:
    """Compose the page on registration, imaging, stereo head, strategies, user methods and raw readings."""
    return _page(
        [
            _all_of(procedures.registration),
            _all_of(procedures.imaging),
            _all_of(procedures.relocalization),
            _all_of(strategy, "Strategy"),
            _all_of(trajectory, "Trajectory"),
            _all_of(contracts, "Localizer", "Pairing", "PairedRegistration", "StrategyFactory"),
            _all_of(raw_readings, "RawReading", "raw_readings", "write_raw"),
            _all_of(frames, "Frame", "Transform"),
        ]
    )


def runs() -> str:
    """Compose the page on runs: how they are made, swept, loaded and compared, and the columns of tables."""
    tables = {
        "targets": run_tables.TARGETS,
        "spheres": run_tables.SPHERES,
        "localized": run_tables.LOCALIZED,
        "registrations": run_tables.REGISTRATIONS,
        "budget": run_tables.BUDGET,
        "strays": recorded_tables.STRAYS,
        "looks": recorded_tables.LOOKS,
        "motions": run_tables.MOTIONS,
        "events": run_tables.EVENTS,
        'registration("T1").spheres': registration_in_ct.SPHERES,
    }
    names = ("load_run", "LoadedRun", "RunRegistration", "RunTable", "RunWarning", "StereoPictures")
    page = _page(
        [
            _all_of(loaded_run, *names),
            _all_of(from_python, "run_case", "compare_runs"),
            _all_of(parameter_sweep, "sweep"),
            _all_of(page_of_two, "RunComparison"),
        ]
    )
    for name, columns in tables.items():
        rows = ((f"`{one.name}`", _format_column_type(one), one.description) for one in columns)
        page += f"\n## `run.{name}`\n\n{table(('column', 'type', 'meaning'), rows)}"
    return page


def _format_column_type(column: loaded_run.RunColumn) -> str:
    kind = column.kind if isinstance(column.kind, str) else column.kind.__name__
    size = " x ".join(map(str, column.size))
    return f"{size} {kind}" if size else kind


def devices() -> str:
    """Compose the page on opening a theatre, device interfaces, readings and drivers."""
    interfaces = Part(
        "ronna_hw.devices",
        [lifecycle.Device, OpticalTracker, RobotArm, robot.JointMove, robot.LineMove, StereoPair],
    )
    own = [
        one for one in vars(readings).values() if inspect.isclass(one) and one.__module__ == readings.__name__
    ]
    return _page(
        [
            _all_of(theatre, "open_theatre", "Theatre"),
            _all_of(theatre, "simulated_theatre", "SimulatedTheatre"),
            _all_of(simulated_room, "SimulatedRoom", "UnseenSphereWarning"),
            _all_of(room_truth, *TRUTH),
            _all_of(stray_tracks, "track_strays", "StrayTrack", "StrayWarning"),
            interfaces,
            Part(readings.__name__, own),
            _driver_part(PolarisTracker, OpticalTracker),
            _driver_part(KukaRsiArm, RobotArm, InsertsInstruments, TellsFeed, TellsLoads),
            _driver_part(
                UniversalRobotsArm,
                RobotArm,
                InsertsInstruments,
                TellsFeed,
                FollowsHand,
                CarriesLoad,
                TellsLoads,
            ),
            _driver_part(BaslerStereoPair, StereoPair),
        ]
    )


def _page(parts: Sequence[Part]) -> str:
    return "\n".join(line for part in parts for line in _part_lines(part)) + "\n"


def _part_lines(part: Part) -> Iterator[str]:
    yield f"## `{part.module}`\n"
    for one in part.objects:
        if inspect.isclass(one):
            yield from _class_lines(one, part.interfaces)
        else:
            yield f"### `{one.__name__}{_format_signature(one)}`\n\n{_docstring(one)}\n"


def _class_lines(one: type, interfaces: tuple[type, ...]) -> Iterator[str]:
    yield f"### class `{one.__name__}`\n\n{_docstring(one)}\n"
    if issubclass(one, Enum):
        yield f"Members: {', '.join(f'`{name}`' for name in one.__members__)}.\n"
    elif is_dataclass(one):
        yield from _field_lines(one, {field.name: field.type for field in fields(one)})
    elif issubclass(one, BaseModel):
        said = {name: field.description or "" for name, field in one.model_fields.items()}
        yield from _field_lines(one, one.__annotations__, said)
    if inspect.isfunction(call := vars(one).get("__call__")) and getattr(one, "_is_protocol", False):
        yield f"- **`{one.__name__}{_format_signature(call)}`**: {_join_lines(_docstring(call))}"
    for name, member in _list_members(one).items():
        if name.startswith("_"):
            continue
        got = member.__func__ if isinstance(member, classmethod | staticmethod) else member
        sources = (getattr(got, "fget", got), *(getattr(two, name, None) for two in interfaces))
        words = next(
            (own_words for two in sources if two is not None and (own_words := inspect.getdoc(two))), ""
        )
        if isinstance(got, property):
            yield f"- **`{name}`**: {_join_lines(words)}"
        elif inspect.isfunction(got):
            yield f"- **`{name}{_format_signature(got)}`**: {_join_lines(words)}"
    yield ""


def _list_members(one: type) -> dict[str, Any]:
    """Return the members of a class, including those of a driver's base classes."""
    rooms = ("drivers.", "ronna_hw.arm_stream.")
    bases = [
        base
        for base in reversed(one.__mro__)
        if base in (one, GuardedDevice) or base.__module__.startswith(rooms)
    ]
    return {name: member for base in bases for name, member in vars(base).items()}


def _field_lines(one: type, types: Mapping[str, Any], said: Mapping[str, str] | None = None) -> Iterator[str]:
    """Yield each field with its type and its description or trailing comment, usually the unit."""
    lines = inspect.getsource(one).splitlines()
    for name, kind in types.items():
        if name.startswith("_"):
            continue
        written = next((line for line in lines if line.startswith(f"    {name}:")), "")
        comment = (said or {}).get(name) or written.partition("  # ")[2]
        yield f"- `{name}`: `{kind}`" + (f"; {comment}" if comment else "")
    yield ""


def _format_signature(function: Any) -> str:
    """Format the signature without `self`, `cls` or type annotations."""
    own_signature = inspect.signature(function)
    kept = [
        one.replace(annotation=one.empty, default=_format_default(one.default))
        for one in own_signature.parameters.values()
        if one.name not in ("self", "cls")
    ]
    return str(own_signature.replace(parameters=kept, return_annotation=own_signature.empty))


def _format_default(value: Any) -> Any:
    return _FunctionDefault() if inspect.isfunction(value) else value


class _FunctionDefault:
    """Stand-in for a function used as default value, shown as `...`."""

    def __repr__(self) -> str:
        return "..."


def _docstring(one: Any) -> str:
    return inspect.cleandoc(one.__doc__ or "")


def _join_lines(words: str) -> str:
    return " ".join(words.split())
