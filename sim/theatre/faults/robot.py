"""Faults of the robot's controller, its links, and its operator controls."""

from __future__ import annotations

from collections.abc import Iterator

from sim.theatre.faults.kinds import Arguments, FaultKind, at_most_all
from sim.theatre.scene.model import Scene

MODES = ("T1", "T2", "AUT", "EXT")
AXES = ("1", "2", "3", "4", "5", "6")
TRIPS = (
    "timeout",
    "rsi_bad",
    "monitor",
    "torque",
    "acceleration",
    "velocity",
    "overspeed",
    "end_switch",
    "singularity",
)


def _mode(arguments: Arguments, _scene: Scene) -> Iterator[str]:
    if arguments[0] not in MODES:
        yield f"there is no operating mode {arguments[0]!r}, only {', '.join(MODES)}"


def _axis(arguments: Arguments, _scene: Scene) -> Iterator[str]:
    if arguments[0] not in AXES:
        yield f"there is no axis {arguments[0]}, only {AXES[0]} to {AXES[-1]}"


def _trip(arguments: Arguments, _scene: Scene) -> Iterator[str]:
    if arguments[0] not in TRIPS:
        yield f"there is no trip {arguments[0]!r}, only {', '.join(TRIPS)}"


def _lasting(name: str, phrase: str, meaning: str) -> FaultKind:
    return FaultKind(name, "robot", phrase, meaning)


def _share(name: str, phrase: str, meaning: str) -> FaultKind:
    return FaultKind(name, "robot", phrase, meaning, check=at_most_all)


def _once(name: str, phrase: str, meaning: str) -> FaultKind:
    return FaultKind(name, "robot", phrase, meaning, momentary=True)


LINK_FAULTS = (
    _share("drop", "drop NUMBER %", "That share of the RSI replies never arrives."),
    _lasting("delay_replies", "delay INT cycles", "Every RSI reply arrives that many cycles late."),
    _share("duplicate_replies", "duplicate NUMBER %", "That share of the RSI replies arrives twice."),
    _share(
        "reorder_replies",
        "reorder NUMBER %",
        "That share of the RSI replies arrives after the following one.",
    ),
    _share("corrupt_replies", "corrupt replies NUMBER %", "That share of the RSI replies arrives corrupted."),
    _share("wrong_ipoc", "wrong ipoc NUMBER %", "That share of the RSI replies carries a wrong time stamp."),
    _share(
        "future_ipoc", "future ipoc NUMBER %", "That share of the RSI replies carries a later time stamp."
    ),
    _lasting("constant_ipoc", "constant ipoc", "All RSI replies carry the time stamp of the first one."),
    _share("missing_ipoc", "missing ipoc NUMBER %", "That share of the RSI replies has no time stamp."),
    _share("wrong_type", "wrong type NUMBER %", "That share of the RSI replies has a wrong root Type."),
    _share(
        "bad_number",
        "bad number NUMBER %",
        "That share of the RSI replies has nan, inf or text in place of a number.",
    ),
    _share(
        "corrupt_telegrams", "corrupt telegrams NUMBER %", "That share of the telegrams is sent corrupted."
    ),
    _share("lose_telegrams", "lose telegrams NUMBER %", "That share of the telegrams is never sent."),
    _lasting("network_cut", "network cut", "Nothing passes on the RSI link in either direction."),
    _lasting(
        "foreign_sender",
        "foreign sender",
        "Another controller sends to the same port, from its own.",
    ),
    _lasting(
        "short_first",
        "short first telegram",
        "A run begins with a nearly empty telegram, as in old RSI versions.",
    ),
)

CELL_FAULTS = (
    _lasting("emergency_stop", "emergency stop", "The emergency stop is pressed and released at the end."),
    _lasting("guard", "guard open", "The guard is open; it stops the arm in AUT and EXT."),
    FaultKind(
        "mode",
        "robot",
        "mode NAME",
        "The key switch is at T1, T2 or AUT, and back at EXT at the end.",
        check=_mode,
    ),
    _lasting(
        "enabling_switch",
        "enabling switch released",
        "The enabling switch is released; matters in T1 and T2.",
    ),
    _lasting("start_key", "start key held", "The start key is held, as T1 and T2 require."),
    _once("drives_off", "drives off", "The drives are switched off."),
    FaultKind(
        "trip",
        "robot",
        "trip NAME",
        f"Whatever is running ends with the message of that cause: {', '.join(TRIPS)}.",
        momentary=True,
        check=_trip,
    ),
    _lasting(
        "clamp",
        "clamp NUMBER deg",
        "Axis corrections are clamped to that distance; Stat reports it, motion continues.",
    ),
    _once("collision", "collision", "The torque monitor stops the arm, with a message."),
    _once(
        "overload",
        "overload",
        "The brakes close without a message: the measured axes stop following until the program is reset.",
    ),
    FaultKind(
        "stick",
        "robot",
        "stick axis INT",
        "That axis moves with stick-slip.",
        check=_axis,
    ),
    _once(
        "program_restart",
        "program restart",
        "The RSI program restarts: other port, other time stamps, new base pose.",
    ),
)

EKI_FAULTS = (
    _once("eki_cut", "eki cut", "Both EKI connections break."),
    _once(
        "eki_overflow", "eki overflow", "A receive buffer is full: the next request ends its EKI connection."
    ),
    _once("eki_half", "eki half telegram", "Only half of the next telegram on each EKI channel is written."),
    _once("eki_garbage", "eki garbage", "The next telegram on each EKI channel is preceded by garbage."),
    _once("eki_padding", "eki padding", "The next telegram on each EKI channel is padded with NUL bytes."),
    _lasting("eki_taken", "eki taken", "Another client occupies both EKI channels: new clients are refused."),
    _lasting("eki_silence", "eki silence", "The EKI program neither reads nor answers."),
)

ROBOT_FAULTS = (*LINK_FAULTS, *CELL_FAULTS, *EKI_FAULTS)
