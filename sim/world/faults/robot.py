"""Robot fault kinds: RSI link, cell and controller, EKI."""

from __future__ import annotations

from sim.world.faults.fault import FaultKinds, OneOf

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
ROBOT = FaultKinds("robot")
declare_lasting, declare_momentary = ROBOT.declare_lasting, ROBOT.declare_momentary

LINK_FAULTS = (
    declare_lasting("drop", "drop NUMBER %", "That share of the RSI replies never arrives."),
    declare_lasting("delay_replies", "delay INT cycles", "Every RSI reply arrives that many cycles late."),
    declare_lasting(
        "duplicate_replies", "duplicate NUMBER %", "That share of the RSI replies arrives twice."
    ),
    declare_lasting(
        "reorder_replies",
        "reorder NUMBER %",
        "That share of the RSI replies arrives after the following one.",
    ),
    declare_lasting(
        "corrupt_replies", "corrupt replies NUMBER %", "That share of the RSI replies arrives corrupted."
    ),
    declare_lasting(
        "wrong_ipoc", "wrong ipoc NUMBER %", "That share of the RSI replies carries a wrong time stamp."
    ),
    declare_lasting(
        "future_ipoc", "future ipoc NUMBER %", "That share of the RSI replies carries a later time stamp."
    ),
    declare_lasting(
        "constant_ipoc", "constant ipoc", "All RSI replies carry the time stamp of the first one."
    ),
    declare_lasting(
        "missing_ipoc", "missing ipoc NUMBER %", "That share of the RSI replies has no time stamp."
    ),
    declare_lasting(
        "wrong_type", "wrong type NUMBER %", "That share of the RSI replies has a wrong root Type."
    ),
    declare_lasting(
        "bad_number",
        "bad number NUMBER %",
        "That share of the RSI replies has nan, inf or text in place of a number.",
    ),
    declare_lasting(
        "corrupt_telegrams", "corrupt telegrams NUMBER %", "That share of the telegrams is sent corrupted."
    ),
    declare_lasting(
        "lose_telegrams", "lose telegrams NUMBER %", "That share of the telegrams is never sent."
    ),
    declare_lasting("network_cut", "network cut", "No packets pass on the RSI link in either direction."),
    declare_lasting(
        "foreign_sender", "foreign sender", "Another controller sends to the same port, from its own."
    ),
    declare_lasting(
        "short_first",
        "short first telegram",
        "A run begins with a nearly empty telegram, as in old RSI versions.",
    ),
)

CELL_FAULTS = (
    declare_lasting(
        "emergency_stop", "emergency stop", "The emergency stop is pressed, and released at the end."
    ),
    declare_lasting("guard", "guard open", "The guard is open; it stops the arm in AUT and EXT."),
    declare_lasting(
        "mode",
        "mode NAME",
        "The mode selector is at T1, T2 or AUT, and back at EXT at the end.",
        OneOf("operating mode", MODES),
    ),
    declare_lasting(
        "enabling_switch",
        "enabling switch released",
        "The enabling switch is released; effective in T1 and T2.",
    ),
    declare_lasting(
        "start_key",
        "start key held",
        "In T1 and T2 an operator holds enabling switch and start key: drives switch on, prompts are "
        "confirmed.",
    ),
    declare_momentary("drives_off", "drives off", "The drives are switched off."),
    declare_momentary(
        "trip",
        "trip NAME",
        f"The running program or motion ends with the message of that cause: {', '.join(TRIPS)}.",
        OneOf("trip", TRIPS),
    ),
    declare_lasting(
        "clamp",
        "clamp NUMBER deg",
        "Axis corrections are clamped to that distance; Stat reports it, motion continues.",
    ),
    declare_lasting(
        "sensor_dead",
        "force sensor dead",
        "The force sensor on the flange repeats its last values; without a sensor there is no effect.",
    ),
    declare_momentary("collision", "collision", "The torque monitor stops the arm, with a message."),
    declare_momentary(
        "overload",
        "overload",
        "The brakes close without a message: the measured axes stop following until the program is reset.",
    ),
    declare_lasting("stick", "stick axis INT", "The axis moves with stick-slip.", OneOf("axis", AXES)),
    declare_momentary(
        "program_restart",
        "program restart",
        "The RSI program restarts: other port, other time stamps, new base pose.",
    ),
)

EKI_FAULTS = (
    declare_momentary("eki_cut", "eki cut", "Both EKI connections break."),
    declare_momentary(
        "eki_overflow", "eki overflow", "A receive buffer is full: the next request ends its EKI connection."
    ),
    declare_momentary(
        "eki_half", "eki half telegram", "Only half of the next telegram on each EKI channel is written."
    ),
    declare_momentary(
        "eki_garbage", "eki garbage", "The next telegram on each EKI channel is preceded by garbage."
    ),
    declare_momentary(
        "eki_padding", "eki padding", "The next telegram on each EKI channel is padded with NUL bytes."
    ),
    declare_lasting(
        "eki_taken", "eki taken", "Another client occupies both EKI channels: new clients are refused."
    ),
    declare_lasting("eki_silence", "eki silence", "The EKI program neither reads nor answers."),
)

ROBOT_FAULTS = (*LINK_FAULTS, *CELL_FAULTS, *EKI_FAULTS)
