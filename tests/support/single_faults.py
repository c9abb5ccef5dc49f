"""Single faults of the three devices, the steps in which they can happen, and how a case may end under each.

Fault -> the codes that a case may end with, whatever the step; where the device does nothing at that moment
the case goes on. What begins only after the fault, a step or a call, is refused and quotes its code.
"""

from collections.abc import Iterator, Sequence

from procedures.journal.journal import Entry, Line
from procedures.steps.branches import FOLLOW, GO_ON, LEAVE_OUT

STOPS = (Entry.FAILED, Entry.REFUSED)  # what a journal has of a fault that stopped a case
LED_ON = (GO_ON, LEAVE_OUT, FOLLOW)  # answers to questions that offer to continue a stopped case
STEPS = {
    "tracker": (
        *("set_up", "global_localization", "relocalization", "tool_change"),
        *("positioning", "at_target", "retreat"),
    ),
    "robot": ("set_up", "relocalization", "tool_change", "positioning", "at_target", "retreat"),
    "camera": ("set_up", "relocalization"),
}
STOPPED = frozenset({"EKI-007", "EKI-008", "EKI-010"})  # by the controller: before, or while the stream runs
REFUSED_PAIR = frozenset({"STE-011", "STE-012", "PRO-008"})
# A reply that is spoilt: no Polaris while connecting; then a wrong CRC or form, or no end in time.
SPOILT_REPLY = frozenset({"NDI-003", "NDI-005", "NDI-006", "NDI-007"})
TRACKER = {
    "occlude marker 1": {"PRO-007", "PRO-017", "PRO-022", "REG-008", "REG-009"},
    "occlude tool robot_frame": {"PRO-007", "PRO-017"},
    "occlude tool robot_frame marker 1": {"PRO-007", "PRO-017"},
    "bend tool robot_frame 2 mm": {"PRO-019", "PRO-007", "PRO-017", "REG-008", "REG-009"},
    "turn tool robot_frame 3 deg": {
        "PRO-019",
        "PRO-007",
        "PRO-017",
        "PRO-008",
        "REG-008",
        "REG-009",
        "PLAN-007",
    },
    "move tool robot_frame +5 +0 +0 mm": {"PRO-019", "PRO-007", "PRO-017", "PRO-008", "REG-009"},
    "interference tool robot_frame": {"PRO-007", "PRO-017"},
    "sunlight": {"PRO-007", "PRO-017", "REG-008", "REG-009"},
    "strays 2": {"REG-008", "REG-009"},
    "reflections 2": set(),
    "phantoms 3 mm": {"PRO-019", "REG-009"},
    "bump": {"NDI-021"},
    "cold": {"NDI-022"},
    "hot": {"NDI-022"},
    "alert 3": {"NDI-020", "NDI-037"},
    "power off": {"NDI-001", "NDI-002", "NDI-007", "NDI-008"},
    "restart": {"NDI-007", "NDI-008", "NDI-009"},
    "watchdog": {"NDI-007", "NDI-009"},
    "repeat frames": {"PRO-007", "PRO-017"},
    # Readings that fail or come late lengthen the time for which the guide covers the head at this target.
    "skip 2 frames": {"PRO-017"},
    "garble commands 5 %": {"NDI-003", "NDI-006", "PRO-017"},
    "garble replies 5 %": {"PRO-017", *SPOILT_REPLY},
    "drop bytes 5 %": {"PRO-017", *SPOILT_REPLY},
    "double bytes 5 %": {"PRO-017", *SPOILT_REPLY},
    "cut replies 5 %": {"NDI-002", "PRO-017", *SPOILT_REPLY},
    "lose replies 5 %": {"NDI-002", "NDI-007", "PRO-017"},
    # NDI-008: while connecting, a late reply belongs to the rate tried before, and the link counts as lost.
    "delay replies 0.5 s": {"NDI-002", "NDI-007", "NDI-008", "PRO-007", "PRO-017"},
    "slow TSTART 1 s": {"PRO-017"},
}
ROBOT = {
    "drop 10 % for 1 s": set(),
    "delay 2 cycles for 0.5 s": STOPPED,
    "duplicate 20 % for 1 s": set(),
    "reorder 10 % for 1 s": set(),
    "corrupt replies 5 % for 1 s": set(),
    "wrong ipoc 5 % for 1 s": set(),
    "future ipoc 5 % for 1 s": set(),
    "constant ipoc": {*STOPPED, "RSI-003"},
    "missing ipoc 5 % for 1 s": set(),
    "wrong type 5 % for 1 s": set(),
    "bad number 5 % for 1 s": set(),
    "corrupt telegrams 5 % for 1 s": set(),
    "lose telegrams 5 % for 1 s": set(),
    "network cut": {*STOPPED, "RSI-002", "RSI-003"},
    # With the controller's host and axes it is answered in its place if its telegram opens the session.
    "foreign sender": {"EKI-010"},
    "emergency stop": STOPPED,
    "guard open": STOPPED,
    "mode T1": {*STOPPED, "EKI-006"},
    "drives off": STOPPED,
    "trip torque": STOPPED,
    "clamp 1 deg": {"RSI-005"},
    "collision": STOPPED,
    "overload": {"RSI-005", *STOPPED},
    "stick axis 3": {"RSI-005", "RSI-011"},
    "program restart": {*STOPPED, "RSI-008"},
    "eki cut": {"EKI-002"},
    "eki overflow": {"EKI-002"},
    "eki half telegram": {"EKI-004"},
    "eki garbage": set(),
    "eki padding": set(),
    "eki silence": {"EKI-001", "EKI-003"},
    "short first telegram": set(),
    "start key held": set(),
}
CAMERA = {
    "stain marker 1 20 %": set(),
    "glare left 20 px": set(),
    "occlude left 20 %": set(),
    "occlude left 60 %": REFUSED_PAIR,
    "twist left +0.2 deg": {"STE-014"},
    "drop 2 %": set(),
    "lose left 5 %": set(),
    "forget left": {"STE-012", "GEV-014"},
    "omit leader left": set(),
    "omit trailer left": set(),
    "omit frames left": set(),
    "shuffle both": set(),
    "duplicate left 20 %": set(),
    "shift area left": REFUSED_PAIR,
    "truncate left": REFUSED_PAIR,
    "unplug left": {"GEV-001", "GEV-014"},
    "ignore heartbeat left": {"GEV-014", "GEV-015"},
    "seize left": {"GEV-005", "GEV-014", "GEV-015"},  # GEV-005: before the case has it
    "delay answers left 50 ms": set(),
    "lose answers left 10 %": set(),
    "restart left": {"GEV-015", "GEV-014", *REFUSED_PAIR},
    "miss triggers left": REFUSED_PAIR,
    "expose late left 5 ms": REFUSED_PAIR,
    "drift left +200 ppm": REFUSED_PAIR,
    "reset clock left": REFUSED_PAIR,
    "saturate both": REFUSED_PAIR,
    "darken both": REFUSED_PAIR,
    "defocus left 3 px": REFUSED_PAIR,
    "dust left 50 spots": set(),
    "narrow path left 600 bytes": {"GEV-012", *REFUSED_PAIR},
    "announce answers left 50 ms": set(),
    "lose events left 50 %": set(),
}
FAULTS = (("tracker", TRACKER), ("robot", ROBOT), ("camera", CAMERA))


def stops(journal: Sequence[Line]) -> Iterator[Sequence[Line]]:
    """For each stop the lines from it to the answer that led on, or to the end of the case."""
    begin = 0
    for number, line in enumerate(journal):
        if begin == 0 and line["entry"] in STOPS:
            begin = number
        elif begin and line["entry"] == Entry.CONFIRMATION and line["answer"] in LED_ON:
            yield journal[begin : number + 1]
            begin = 0
    if begin:
        yield journal[begin:]
