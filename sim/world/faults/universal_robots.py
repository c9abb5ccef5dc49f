"""Fault kinds of a Universal Robots controller: its links, safety system and programs."""

from __future__ import annotations

from sim.world.faults.fault import FaultKinds, check_at_most

FARTHEST_MM = 500.0

UR = FaultKinds("ur", prefix="ur_")
declare_lasting, declare_momentary = UR.declare_lasting, UR.declare_momentary

LINK_FAULTS = (
    declare_lasting("skip", "skip NUMBER %", "That share of the RTDE packages is never sent."),
    declare_lasting("late", "late INT cycles", "What RTDE clients send takes effect that many cycles late."),
    declare_lasting(
        "lose", "lose NUMBER %", "That share of the RTDE data packages of clients has no effect."
    ),
    declare_lasting(
        "cable",
        "cable pulled",
        "Nothing passes in either direction, on new connections neither; what was sent arrives at the end.",
    ),
    declare_lasting("frozen", "frozen", "No control cycle runs and nobody is answered; connections stay."),
    declare_lasting(
        "registers_taken",
        "registers taken",
        "Another client owns the registers of clients: whoever asks for them anew gets IN_USE.",
    ),
    declare_lasting("dashboard_silent", "dashboard silent", "The dashboard does not answer."),
    declare_momentary("cut", "cut connections", "All connections are closed."),
    declare_momentary("cut_rtde", "cut rtde", "All RTDE connections are closed."),
    declare_momentary("garbage", "garbage", "The next RTDE package of each client is preceded by garbage."),
)

CELL_FAULTS = (
    declare_lasting(
        "emergency_stop",
        "emergency stop pressed",
        "The robot's emergency stop is pressed, and released at the end.",
    ),
    declare_lasting(
        "system_emergency_stop",
        "system emergency stop pressed",
        "An emergency stop of the cell is pressed, and released at the end.",
    ),
    declare_lasting(
        "safeguard", "safeguard open", "A safeguard stop acts: the arm rests with its drives on."
    ),
    declare_lasting("reduced", "reduced mode", "The safety system is in reduced mode."),
    declare_lasting(
        "local", "local mode", "The pendant is in local mode: no scripts, and dashboard queries only."
    ),
    declare_lasting(
        "speed_slider", "speed slider NUMBER %", "The speed slider stands there, and at its place after."
    ),
    declare_momentary("protective_stop", "protective stop", "The arm has touched something."),
    declare_momentary("violation", "violation", "A limit of the safety system was exceeded."),
    declare_momentary("fault", "fault", "The safety system has found a fault of its own."),
    declare_momentary("power_off", "power off", "The power of the arm is switched off."),
    declare_momentary("program_stop", "program stop", "Somebody stops the program at the pendant."),
    declare_momentary("program_pause", "program pause", "Somebody pauses the program at the pendant."),
)


LOADS = (
    declare_lasting(
        "load",
        "load axial NUMBER N",
        "That force pushes the tool back along its axis.",
    ),
    declare_lasting(
        "tissue",
        "tissue NUMBER mm ahead",
        "Skin, bone and brain begin so far ahead on the axis of the tool, or of the instrument in a holder.",
        check_at_most(FARTHEST_MM, "mm"),
    ),
    declare_lasting(
        "hand", "hand SIGNED SIGNED SIGNED N", "A hand pushes the tool, along x y z of the base."
    ),
    declare_lasting(
        "load_kept", "load kept", "A new payload or tool centre point has no effect on the controller."
    ),
)

UR_FAULTS = (*LINK_FAULTS, *CELL_FAULTS, *LOADS)
