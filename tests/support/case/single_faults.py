"""Single faults as one table: each fault, the steps in which it begins, how the case ends, in what time.

A row's ends are the codes that a case may stop with, and DONE where it may go on: with codes alone it must
stop, and what begins only after the fault, a step or a call, is refused and quotes its code.
Its times are promised from the beginning of the fault until the arm rests. What a device notices goes by the
host's clock, for the theatre's runs free while a link is silent in lock-step; what a step or a guard notices
goes by the theatre's, for a busy computer stretches the host's.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

from procedures.journal.errors import StepRefused
from procedures.journal.journal import Entry, Line
from procedures.operator.question import Topic
from procedures.steps.branches import FOLLOW, GO_ON, LEAVE_OUT
from sim.world.scene.model import Fiducial, Scene

DONE = "done"
SINCE = "since"
FEWEST = 3  # spheres of the mini scene
OTHERS = ""  # all steps of a fault's device that no other row of the fault names
DEVICE_CODES = ("NDI-", "EKI-", "RSI-", "GEV-", "URD-")
STOPS = (Entry.FAILED, Entry.REFUSED)  # what a journal has of a fault that stopped a case
CODE = re.compile(r"[A-Z]+-\d{3}")
QUOTING = {"PRO-001", "DEV-001"}  # a step, or a call in it, that came after the fault and is refused for it
LED_ON = (GO_ON, LEAVE_OUT, FOLLOW)  # answers to questions that offer to continue a stopped case

STEPS = {
    "tracker": (
        *("set_up", "cart_lock", "global_localization", "relocalization"),
        *("tool_change", "positioning", "at_target", "retreat"),
    ),
    "robot": (
        *("set_up", "relocalization", "tool_change", "tool_check"),
        *("positioning", "at_target", "retreat"),
    ),
    "camera": ("set_up", "relocalization"),
}
# Steps that stand in no row of a device: nothing of it is used there, or as in the step that is named.
COMPUTED = (
    "ct_import",
    "fiducial_localization",
    "plan_check",
    "correspondence",
    "path_check",
    "registration",
)
AS_IN = {
    "tracker": {"head_clamp": "cart_lock", "tool_check": "tool_change", "confirmation": "tool_change"},
    "robot": {
        **dict.fromkeys(("head_clamp", "cart_lock", "global_localization"), "set_up"),  # it is at rest
        "confirmation": "tool_check",  # over the gauge
    },
    "camera": dict.fromkeys(
        (
            *("head_clamp", "cart_lock", "global_localization"),
            *("tool_change", "tool_check", "positioning", "at_target", "retreat", "confirmation"),
        ),
        "set_up",  # connected; no picture is taken
    ),
}


class Row(NamedTuple):
    """How a case ends when one fault begins in one of some steps."""

    fault: str  # as in a script, with its device
    steps: str
    ends: str  # DONE, codes, or both
    host_s: float | None = None  # within which the case rests if a device notices
    theatre_s: float | None = None  # and if a step or a guard does
    begins: str = "when"  # it acts while the step runs; "since": from then on
    after_s: float = 0.0  # with "since": of theatre time, from the beginning of the step
    markers: int = FEWEST
    scene: str = ""  # one of SCENES, in place of a fault of a script
    answers: str = ""  # of the operator, as in a file of answers
    branch: str = ""  # of the table of branches, that it reaches
    asks: Topic | None = None  # the question that the operator must have been asked
    in_doubt: bool = False  # a case that goes on ends in doubt: what was worked at may have moved before
    arms: tuple[str, ...] = ()  # options of a case with two


class Cell(NamedTuple):
    """One case of the matrix."""

    name: str
    line: str  # of the fault script
    step: str
    codes: frozenset[str]
    may_be_done: bool
    row: Row


def _fiducial(number: int, **changed: object) -> Callable[[Scene], Scene]:
    def change(scene: Scene) -> Scene:
        def one(fiducial: Fiducial) -> Fiducial:
            return fiducial.model_copy(update=changed) if fiducial.number == number else fiducial

        head = scene.head.model_copy(update={"fiducials": tuple(map(one, scene.head.fiducials))})
        return scene.model_copy(update={"head": head})

    return change


def _strict(scene: Scene) -> Scene:
    targets = tuple(one.model_copy(update={"margin_mm": 0.1}) for one in scene.head.targets)
    return scene.model_copy(update={"head": scene.head.model_copy(update={"targets": targets})})


def _far(scene: Scene) -> Scene:
    x, y, z = scene.head.robot_from_ct.translation_mm
    there = scene.head.robot_from_ct.model_copy(update={"translation_mm": (x + 250.0, y, z)})
    return scene.model_copy(update={"head": scene.head.model_copy(update={"robot_from_ct": there})})


# What is wrong before a case begins, which no fault of a script can bring about.
SMALL, MISSING = "a sphere that the CT does not show", "a sphere that was not attached again"
FAR_OFF, OFF = "a screw that gave way by 8 mm", "a screw that gave way by 1 mm"
OUT_OF_REACH, STRICT = "a head out of reach", "a margin that no registration keeps"
SCENES: dict[str, Callable[[Scene], Scene]] = {
    SMALL: _fiducial(2, radius_mm=2.0),
    MISSING: _fiducial(2, missing=True),
    FAR_OFF: _fiducial(2, displaced_mm=(8.0, 0.0, 0.0)),
    OFF: _fiducial(2, displaced_mm=(1.0, 0.0, 0.0)),
    OUT_OF_REACH: _far,
    STRICT: _strict,
}

STOPPED = "EKI-007 EKI-008 EKI-010"  # by the controller: before, or while the stream runs
SPOILT_REPLY = "NDI-003 NDI-005 NDI-006 NDI-007"  # a wrong CRC or form, or no end in time; no Polaris at all
CONNECTING = "set_up"
TWO_KUKA, UR_ASSISTS = ("--dual",), ("--dual", "--assistant-arm", "ur5e")
# What stops an arm between two motions is told by that arm.
UR_STOPS, UR_LINK, KUKA_STOPS = (
    "URD-035 URD-036 URD-043 URD-044",
    "URD-014 URD-021 URD-022",
    "EKI-002 EKI-010",
)
ARM_STOPS = (
    *(f"assistant ur {fault}" for fault in ("protective stop", "emergency stop pressed", "safeguard open")),
    *(f"assistant ur {fault}" for fault in ("violation", "fault", "power off", "program stop")),
    *(f"assistant ur {fault}" for fault in ("program pause", "local mode", "cut rtde", "cut connections")),
    *(f"assistant robot {fault}" for fault in ("emergency stop", "collision", "eki cut")),
)
SILENT_ARMS = ("assistant ur cable pulled", "assistant ur frozen", "assistant robot network cut")
BASES = "base_to_base"
# Theatre time from the beginning of a step to an amid motion of the assistant, in the mini scene.
LOOKED_AT_S, OVER_HEAD_S, IN_BORE_S = 22.0, 6.0, 25.0
AT_ONCE_S = 3  # of the theatre, from a stop by the controller until both arms are at rest
UNMATCHED = Topic.UNMATCHED_SPHERE


def told_by_arm(fault: str) -> str:
    """Return the codes with which an assistant tells of a fault between two motions."""
    if not fault.startswith("assistant ur "):
        return KUKA_STOPS
    return UR_LINK if fault.split()[2] in ("cut", "cable", "frozen") else UR_STOPS


def arms_with(fault: str) -> tuple[str, ...]:
    """Return the options of a case whose assistant can have a fault."""
    return UR_ASSISTS if fault.startswith("assistant ur ") else TWO_KUKA


ROWS = (
    # The tracker: what it sees.
    Row("tracker occlude marker 1", "global_localization", "PRO-007", theatre_s=5),
    Row("tracker occlude marker 1", "cart_lock", "PRO-007", theatre_s=5),
    Row("tracker occlude marker 1", "positioning", "PRO-022", theatre_s=5),
    Row("tracker occlude marker 1", OTHERS, DONE),
    Row("tracker occlude tool robot_frame", "cart_lock", "PRO-007 PRO-017", theatre_s=5),
    Row(
        "tracker occlude tool robot_frame",
        "global_localization",
        "PRO-017",
        theatre_s=5,
        branch="GUARD_UNMET",
    ),
    # The look with the arm home, before the spheres are localized again: the cart may move unnoticed.
    Row("tracker occlude tool robot_frame", "relocalization", "PRO-007", theatre_s=5),
    Row("tracker occlude tool robot_frame", "positioning", "PRO-022", theatre_s=5),
    Row("tracker occlude tool robot_frame", OTHERS, DONE),
    Row("tracker occlude tool robot_frame marker 1", OTHERS, DONE),
    Row("tracker bend tool robot_frame 2 mm", "positioning", "PRO-019", theatre_s=15),
    Row("tracker bend tool robot_frame 2 mm", "at_target", "PRO-017", theatre_s=15),
    Row("tracker bend tool robot_frame 2 mm", OTHERS, DONE),
    Row(
        "tracker turn tool robot_frame 3 deg",
        "global_localization",
        "PRO-007",
        theatre_s=30,
        branch="WRONG_SPHERE",
    ),
    Row("tracker turn tool robot_frame 3 deg", "relocalization", DONE),
    # A frame turned about its own place looks as if the guide's seat had given way.
    Row("tracker turn tool robot_frame 3 deg", "positioning", "TOOL-006", theatre_s=15),
    Row("tracker turn tool robot_frame 3 deg", OTHERS, "done PRO-017 PRO-019", theatre_s=15),
    Row(
        "tracker move tool robot_frame +5 +0 +0 mm",
        "global_localization positioning",
        "PRO-019",
        theatre_s=10,
        asks=Topic.CART_MOVED,
    ),
    Row("tracker move tool robot_frame +5 +0 +0 mm", "at_target", "PRO-017", theatre_s=10),
    Row("tracker move tool robot_frame +5 +0 +0 mm", OTHERS, "done PRO-019", theatre_s=10),
    Row("tracker interference tool robot_frame", "global_localization", "PRO-017", theatre_s=5),
    # A disturbed frame is not compared: before a target it counts as not seen.
    Row("tracker interference tool robot_frame", "positioning", "PRO-022", theatre_s=5),
    Row("tracker interference tool robot_frame", OTHERS, "done PRO-007 PRO-017", theatre_s=15),
    Row("tracker sunlight", "global_localization", "PRO-017", theatre_s=5),
    Row("tracker sunlight", "positioning", "PRO-022", theatre_s=5),
    Row("tracker sunlight", OTHERS, "done PRO-007 PRO-017 REG-008", theatre_s=15),
    Row("tracker strays 2", OTHERS, DONE),
    Row("tracker reflections 2", OTHERS, DONE),
    Row("tracker phantoms 3 mm", OTHERS, "done PRO-019", theatre_s=15),
    # The tracker: the unit and its line. The way out is never held up.
    *(
        Row(f"tracker {fault}", steps, ends, host_s=host_s)
        for fault, code, looks in (  # how the look after the way out ends: a silent unit refuses it
            ("bump", "NDI-021", ""),
            ("cold", "NDI-022", DONE),
            ("hot", "NDI-022", DONE),
            ("alert 3", "NDI-020 NDI-037", ""),
            ("power off", "NDI-001 NDI-002 NDI-007 NDI-008", ""),
        )
        for steps, ends, host_s in (
            ("set_up", code, 20),
            ("retreat", looks or code, 60),
            (OTHERS, code, 15),
        )
    ),
    Row("tracker restart", "set_up", DONE),
    Row("tracker restart", OTHERS, "NDI-007 NDI-008 NDI-009", host_s=15),
    Row("tracker watchdog", OTHERS, DONE),
    Row("tracker repeat frames", "set_up retreat", DONE),
    Row("tracker repeat frames", "global_localization", "PRO-007", theatre_s=15, branch="SIGHT_LOST"),
    Row("tracker repeat frames", OTHERS, "PRO-007", theatre_s=15),
    # Readings that fail or come late lengthen the time for which the guide covers the head at this target:
    # two frames of three to about as long as it may be unseen, so that the pace of the computer decides.
    Row("tracker skip 2 frames", "at_target", "done PRO-017", theatre_s=15),
    Row("tracker skip 2 frames", OTHERS, DONE),
    Row(
        "tracker slow TSTART 1 s",
        "positioning at_target",
        "PRO-017",
        theatre_s=20,
        branch="HEAD_UNSEEN",
        asks=Topic.HEAD_UNSEEN,
    ),
    Row("tracker slow TSTART 1 s", OTHERS, DONE),
    Row("tracker delay replies 0.5 s", "set_up", "NDI-002 NDI-007 NDI-008", host_s=20),
    Row("tracker delay replies 0.5 s", "global_localization at_target", "PRO-017", theatre_s=30),
    # Before the approach is asked for and again before it moves, each look over such a line takes 16 s.
    Row("tracker delay replies 0.5 s", "positioning", "PRO-017", theatre_s=60),
    Row("tracker delay replies 0.5 s", "cart_lock", "done PRO-017", theatre_s=30),
    Row("tracker delay replies 0.5 s", OTHERS, DONE),
    *(
        # A look over such a line takes 13 s to 23 s, and there are three before the checkpoint that suspends.
        Row(f"tracker {fault}", steps, ends, host_s=20, theatre_s=80)
        for fault, code in (
            ("garble commands 5 %", "NDI-003 NDI-006"),
            ("garble replies 5 %", SPOILT_REPLY),
            ("drop bytes 5 %", SPOILT_REPLY),
            ("double bytes 5 %", SPOILT_REPLY),
            ("cut replies 5 %", f"NDI-002 {SPOILT_REPLY}"),
            ("lose replies 5 %", "NDI-002 NDI-007"),
        )
        for steps, ends in (
            ("positioning at_target", f"done PRO-017 {code}"),
            ("retreat", DONE),
            (OTHERS, f"done {code}"),
        )
    ),
    # The tracker: what only a connection meets.
    Row("tracker corrupt definitions", CONNECTING, "NDI-035", host_s=15),
    Row("tracker allow 0 tools", CONNECTING, "NDI-035", host_s=15),
    Row("tracker allow 0 handles", CONNECTING, "NDI-034", host_s=15),
    Row("tracker wrong wavelength", "set_up retreat", DONE),
    Row("tracker wrong wavelength", OTHERS, "NDI-035", host_s=10),
    Row("tracker plug 1", CONNECTING, DONE),
    Row("tracker unplug 1", CONNECTING, DONE),  # no tool of a case is wired
    # The robot: its stream.
    *(
        Row(f"robot {fault}", OTHERS, DONE)
        for fault in (
            *("drop 10 % for 1 s", "duplicate 20 % for 1 s", "reorder 10 % for 1 s"),
            *("corrupt replies 5 % for 1 s", "wrong ipoc 5 % for 1 s", "future ipoc 5 % for 1 s"),
            *("missing ipoc 5 % for 1 s", "wrong type 5 % for 1 s", "bad number 5 % for 1 s"),
            *("corrupt telegrams 5 % for 1 s", "lose telegrams 5 % for 1 s", "short first telegram"),
            *("eki garbage", "eki padding", "start key held", "enabling switch released"),
        )
    ),
    Row("robot delay 2 cycles for 0.5 s", OTHERS, f"done {STOPPED}", host_s=15),
    Row("robot constant ipoc", "set_up", DONE),
    Row("robot constant ipoc", OTHERS, f"{STOPPED} RSI-003", host_s=15),
    Row("robot network cut", "set_up", DONE),
    Row("robot network cut", OTHERS, f"{STOPPED} RSI-002 RSI-003", host_s=15),
    # With the controller's host and axes it is answered in its place if its telegram opens the session.
    Row("robot foreign sender", "set_up", DONE),
    Row("robot foreign sender", OTHERS, "done EKI-010", host_s=15),
    Row("robot program restart", "set_up", DONE),
    # These begin with the link at rest: what restarts then is found anew where the link begins again.
    Row(
        "robot program restart",
        "relocalization tool_check positioning",
        f"done {STOPPED} RSI-008",
        host_s=15,
    ),
    Row("robot program restart", OTHERS, f"{STOPPED} RSI-008", host_s=10),
    # The robot: the controller. What happens while it is at rest is met where its stream begins.
    *(
        Row(f"robot {fault}", steps, STOPPED, host_s=host_s, branch="ARM_FAULT")
        for fault in ("emergency stop", "guard open", "collision")
        for steps, host_s in (("set_up", 20), (OTHERS, 5))
    ),
    Row("robot force sensor dead", OTHERS, DONE),  # the master has none
    Row("robot mode T1", "set_up", DONE),
    Row("robot mode T1", OTHERS, f"{STOPPED} EKI-006", host_s=20),
    *(
        Row(f"robot {fault}", steps, ends, host_s=5)
        for fault in ("drives off", "trip torque")
        for steps, ends in (
            ("set_up relocalization", DONE),
            ("tool_check", f"done {STOPPED}"),
            (OTHERS, STOPPED),
        )
    ),
    Row("robot clamp 1 deg", "set_up at_target", DONE),
    Row("robot clamp 1 deg", OTHERS, "RSI-005", host_s=10),
    Row("robot overload", "set_up at_target", "RSI-005", host_s=20),  # where it moves next
    Row("robot overload", "positioning", f"done RSI-005 {STOPPED}", host_s=20),  # resets the program at first
    Row("robot overload", OTHERS, f"RSI-005 {STOPPED}", host_s=10),
    Row("robot stick axis 3", "set_up at_target", DONE),
    Row("robot stick axis 3", "relocalization tool_change", "RSI-005 RSI-011", host_s=20),
    Row("robot stick axis 3", OTHERS, "done RSI-005 RSI-011", host_s=20),
    # The robot: its EKI connections.
    *(
        Row(f"robot {fault}", steps, ends, host_s=10)
        for fault, code in (
            ("eki cut", "EKI-002"),
            ("eki overflow", "EKI-002"),
            ("eki half telegram", "EKI-004"),
        )
        for steps, ends in (("set_up", f"done {code}"), (OTHERS, code))  # it may come before the connection
    ),
    Row("robot eki silence", OTHERS, "EKI-001 EKI-003", host_s=20),
    Row("robot eki taken", CONNECTING, "EKI-001 EKI-002", host_s=15),
    # The cameras: pictures.
    *(
        Row(f"camera {fault}", OTHERS, DONE)
        for fault in (
            *("stain marker 1 20 %", "glare left 20 px", "occlude left 20 %", "dust left 50 spots"),
            *("drop 2 %", "lose left 5 %", "forget left", "omit leader left", "omit trailer left"),
            *("omit frames left", "shuffle both", "duplicate left 20 %", "defocus left 3 px"),
            *("expose late left 5 ms", "drift left +200 ppm", "reset clock left", "delay answers left 50 ms"),
            *("pulse line", "lose answers left 10 %", "announce answers left 50 ms", "lose events left 50 %"),
            *("lamp 5 %", "hand 5 mm", "projector dark", "hold line both"),  # the latter for a projector only
        )
    ),
    *(
        Row(f"camera {fault}", steps, ends, theatre_s=theatre_s)
        for fault, code, theatre_s in (
            ("stain marker 2 60 %", "PRO-008", 90),
            ("occlude left 60 %", "PRO-008", 60),
            ("darken both", "PRO-008", 60),
            ("saturate both", "STE-011", 10),
            ("twist left +0.2 deg", "STE-014", 40),
            ("creep left +5 deg per min", "STE-007 STE-014", 40),
            ("shift area left", "STE-012", 10),
            ("truncate left", "STE-012", 20),
            ("miss triggers left", "STE-012", 20),
            ("narrow path left 600 bytes", "STE-012", 20),
        )
        for steps, ends in (("set_up", DONE), ("relocalization", code))
    ),
    Row(
        "camera stain marker 2 60 %",
        "relocalization",
        DONE,
        markers=5,
        branch="SPHERE_FAILED",
        asks=Topic.SPHERE,
    ),
    # The cameras: who has control of them.
    Row("camera unplug left", "set_up", "GEV-001", host_s=10),
    Row("camera unplug left", "relocalization", "GEV-014", host_s=10),
    Row("camera seize left", "set_up", "GEV-005", host_s=15),  # before the case has it
    Row("camera seize left", "relocalization", "GEV-014 GEV-015", host_s=10),
    Row("camera ignore heartbeat left", "set_up", DONE),
    Row("camera ignore heartbeat left", "relocalization", "GEV-014 GEV-015", host_s=10),
    Row("camera restart left", "set_up", DONE),
    Row("camera restart left", "relocalization", "GEV-014 GEV-015", host_s=10),
    # The room: what is moved stays moved. Cart and tracker: the operator agrees to localize again.
    Row("room shift head 0.3 0.4 0 mm", "cart_lock global_localization", DONE, begins=SINCE),
    # without --drill nothing of the skull is felt; with it: `tests/unit/world/test_drilling.py`
    Row("room bone thicker -3 mm", "at_target", DONE, begins=SINCE, arms=("--dual",)),
    Row("room drill stalls", "at_target", DONE, begins=SINCE, arms=("--dual",)),
    Row("room drill pushed aside 6 0 N", "at_target", DONE, begins=SINCE, arms=("--dual",)),
    Row(
        "room shift head 0.3 0.4 0 mm",
        "path_check relocalization registration tool_change tool_check positioning retreat",
        "PRO-020",
        theatre_s=10,
        begins=SINCE,
        branch="REFERENCE_MOVED",
    ),
    # The arm hides the head at this target: noticed on the way out, within the 10 s that are allowed unseen.
    Row("room shift head 0.3 0.4 0 mm", "at_target", "PRO-020", theatre_s=10, begins=SINCE),
    Row(
        "room shift cart 1.0 1.4 0 mm",
        "path_check relocalization tool_change tool_check positioning",
        "done PRO-019",
        theatre_s=10,
        begins=SINCE,
        branch="CART_MOVED",
        asks=Topic.CART_MOVED,
    ),
    # Head and arm agree on a tracker that was moved: it is followed.
    Row(
        "room shift tracker 1.0 1.4 0 mm",
        "path_check relocalization tool_check positioning retreat",
        DONE,
        begins=SINCE,
    ),
    # Over a sphere the arm hides the head: nothing tells the tracker from the cart.
    Row(
        "room shift tracker 1.0 1.4 0 mm",
        "tool_change",
        "done PRO-019",
        theatre_s=10,
        begins=SINCE,
        branch="CART_MOVED",
        asks=Topic.CART_MOVED,
    ),
    # With the guide at the head, what moves the frame on the arm is held as a hand is, until the arm is home.
    *(
        Row(f"room shift {what} 1.0 1.4 0 mm", "at_target", "PRO-017", theatre_s=10, begins=SINCE)
        for what in ("cart", "tracker")
    ),
    # No target remains that depends on the cart, but the look after the last one cannot tell when that
    # was moved.
    Row("room shift cart 1.0 1.4 0 mm", "retreat", DONE, begins=SINCE, in_doubt=True),
    Row(  # wheeled away, not pushed: the home is elsewhere too
        "room move cart 1 40 -20 0 mm 3 deg in 0.1 s",
        "path_check relocalization positioning at_target",
        "done PRO-019",
        theatre_s=10,
        begins=SINCE,
        branch="CART_MOVED",
        asks=Topic.CART_MOVED,
    ),
    *(
        Row(f"room unlocked cart {fault}", steps, ends, theatre_s=20, begins=SINCE, branch=branch)
        for fault in ("0 40 0 mm per min",)
        for steps, ends, branch in (
            ("cart_lock", "PRO-041", "CART_UNLOCKED"),
            ("relocalization", "STE-007 PRO-019", "SPHERE_FAILED"),  # the sphere runs away from the servo
            ("positioning at_target", "PRO-019", "CART_MOVED"),
        )
    ),
    Row(
        "room loosen marker 2 8 0 0 mm",
        "global_localization",
        "REG-008",
        theatre_s=5,
        begins=SINCE,
        branch="AMBIGUOUS",
    ),
    Row(
        "room loosen marker 2 2 0 0 mm",
        "relocalization tool_check positioning at_target",
        "PRO-020",
        theatre_s=20,
        begins=SINCE,
    ),
    # A sphere on the table beside the head is no fiducial: no distance to the others is that of the CT.
    Row(
        "room extra sphere 700 200 100 mm",
        "global_localization positioning",
        DONE,
        begins=SINCE,
    ),
    # The room: the guide, and the hands that mount it and work with it.
    # The look with the arm home, before the gauge or the target: the frame is 0.5 mm from where the arm has
    # it, as if the cart had moved.
    Row("room push guide 0 40 0 N", "tool_check", "PRO-019", theatre_s=15),
    Row("room push guide 0 40 0 N", "positioning", "PRO-019", theatre_s=20),
    Row("room push guide 0 40 0 N", "at_target", "PRO-017", theatre_s=5, branch="GUIDE_PUSHED"),
    Row("room turn guide 0 0.3 0 deg", "at_target", "PRO-017", theatre_s=5, branch="GUIDE_PUSHED"),
    Row("room push guide 0 60 0 N over 1 s", "positioning", "PRO-019 PRO-052", theatre_s=25, begins=SINCE),
    Row("room shift head 0 1 0 mm over 2 s", "tool_check positioning", "PRO-020", theatre_s=30, begins=SINCE),
    Row("room turn head 0 0 1 deg over 2 s", "tool_check positioning", "PRO-020", theatre_s=30, begins=SINCE),
    # Of an instrument beyond its depth stop nobody measures anything: truth alone has it.
    *(
        Row(f"room {fault}", "at_target", DONE)
        for fault in ("bent instrument 0.1 0 mm", "wrong instrument 0.1 mm")
    ),
    Row("room depth stop off by 0.5 mm", "at_target", "TOOL-004", theatre_s=5, branch="WRONG_STOP"),
    *(
        Row(
            f"room {fault}",
            "tool_change tool_check",
            "TOOL-005",
            theatre_s=30,
            begins=SINCE,
            branch="TOOL_BESIDE_GAUGE",
        )
        for fault in (
            "bent tip 0.3 0 0 mm",
            "wrong mandrel 1 mm",
            "bad seat 0.3 mm 0.1 deg",
            "wrong load 2 kg",
        )
    ),
    *(
        Row(
            f"room wrong tool {number}",
            "tool_change",
            "PRO-009",
            theatre_s=10,
            branch="WRONG_TOOL",
            asks=Topic.TOOL_CHANGE,
        )
        for number in (0, 1)
    ),
    # Two arms: what stops the assistant stops both, while it is looked at, over the head, and in the bore.
    # The theatre's time runs free while a link is silent: for 2.5 s of the host, as fast as that is.
    *(
        Row(
            fault,
            step,
            f"DUAL-001 {told_by_arm(fault)}",
            theatre_s=theatre_s,
            host_s=30,
            begins=SINCE,
            after_s=after_s,
            arms=arms_with(fault),
        )
        for faults, theatre_s in ((ARM_STOPS, AT_ONCE_S), (SILENT_ARMS, 300))
        for fault in faults
        for step, after_s in ((BASES, LOOKED_AT_S), ("at_target", OVER_HEAD_S), ("at_target", IN_BORE_S))
    ),
    *(
        Row(
            f"assistant ur {resists}",
            "at_target",
            "ARM-015",
            theatre_s=theatre_s,
            begins=SINCE,
            after_s=IN_BORE_S,
            arms=UR_ASSISTS,
        )
        for resists, theatre_s in (("load axial 25 N", 5), ("tissue 5 mm ahead", 8))
    ),
    *(
        Row(
            f"room move cart {cart} 0 1.5 0 mm 0 deg in 0.1 s",
            "at_target",
            ends,
            theatre_s=5,
            begins=SINCE,
            after_s=IN_BORE_S,
            arms=UR_ASSISTS,
        )
        for cart, ends in ((1, "PRO-054 PRO-019"), (2, "PRO-054"))
    ),
    Row("room loose instrument 0.1 0 0 mm 0.05 deg", "at_target", DONE, begins=SINCE, arms=TWO_KUKA),
    Row(
        "assistant ur speed slider 0 % for 3 s",
        BASES,
        DONE,
        begins=SINCE,
        after_s=LOOKED_AT_S,
        arms=UR_ASSISTS,
    ),
    # Two arms: a cart that is pushed, the master's before they are measured against each other.
    Row(
        "room move cart 1 3 0 0 mm 0 deg in 0.1 s",
        BASES,
        "done PRO-019",
        theatre_s=5,
        begins=SINCE,
        arms=TWO_KUKA,
    ),
    Row(
        "room move cart 2 3 0 0 mm 0 deg in 0.1 s",
        "tool_check",
        "done CAL-023",
        theatre_s=40,
        begins=SINCE,
        asks=Topic.CART_MOVED,
        arms=TWO_KUKA,
    ),
    # What was wrong before the case began, and an operator who answers otherwise than a rehearsal.
    Row("", "plan_check", "PLAN-008", theatre_s=5, scene=SMALL, branch="SPHERE_COUNT"),
    Row("", "plan_check", DONE, scene=SMALL, markers=5, branch="SPHERE_COUNT", asks=Topic.SPHERE_COUNT),
    Row("", "head_clamp", "PRO-007", theatre_s=5, scene=MISSING),
    *(
        Row("", "correspondence", DONE, scene=scene, markers=5, branch="UNMATCHED_SPHERE", asks=UNMATCHED)
        for scene in (MISSING, FAR_OFF)
    ),
    Row("", "path_check", DONE, scene=OUT_OF_REACH, branch="UNREACHABLE", asks=Topic.UNREACHABLE),
    Row("", "registration", "PRO-007", theatre_s=5, scene=OFF, markers=5, branch="FIT_DISAGREES"),
    Row("", "registration", DONE, scene=OFF, markers=6, branch="MOVED_SPHERE", asks=Topic.MOVED_SPHERE),
    Row("", "registration", "PRO-007", theatre_s=5, scene=STRICT, branch="BEYOND_MARGIN"),
    Row(
        "",
        "tool_check",
        "PRO-002",
        theatre_s=10,
        answers='instrument_out = "inside"',
        branch="INSTRUMENT_INSIDE",
    ),
)
# Branches that no single fault of a theatre reaches in a case that begins anew, and what it would take.
BY_SKIN = "a case that scans the skin"
ELSEWHERE = {
    **dict.fromkeys(
        (
            *("UNLIKE_LANDMARKS", "MIRRORED_SKIN", "UNPAIRED_BESIDE_SKIN", "FEW_LOOKS", "DARK_SCAN"),
            *("UNMEASURED_BESIDE_SKIN", "LITTLE_SKIN", "UNLIKE_SKIN", "LOOKS_DISAGREE", "SKIN_MOVED"),
            *("SPHERE_OFF_SKIN", "CARRIED_ELSEWHERE", "HEAD_NOT_FOUND"),
        ),
        BY_SKIN,
    ),
    "CT_DISAGREEMENT": "a fault of the scanner: the result says so, and the case goes on",
    "CART_MISPLACED": "a proposed place in the folder of the case",
    "MIRRORED_CT": "a CT or a plan that is mirrored before the case begins",
    "CORRECTION_BEYOND": "calibrations of another arm or head, whose errors the residual does not show",
    "MOVE_FOLLOWED": "an operator who repeats the registration",
    "REFERENCE_UNDECIDED": "the frame of the patient on the head clamp, which its scene does not have",
    "NOT_CLEAR_NOW": "a registration far from the coarse one",
    "KEPT_BASES": "a fault of an arm that was acknowledged, in a case with two",
    "KEPT_REGISTRATION": "a fault of the arm that was acknowledged",
    "WORK_BEGUN": "a restart after the work at a target has begun",
    "ABORTED": "an operator who ends the case",
}


def cells() -> tuple[Cell, ...]:
    """The matrix: each row in each of its steps."""
    return tuple(_cell(row, step) for row in ROWS for step in steps_of(row))


def steps_of(row: Row) -> tuple[str, ...]:
    """The steps in which it begins."""
    if row.steps != OTHERS:
        return tuple(row.steps.split())
    named = {step for other in ROWS if other.fault == row.fault for step in other.steps.split()}
    return tuple(step for step in STEPS[device_of(row)] if step not in named)


def device_of(row: Row) -> str:
    """The device of its fault."""
    return row.fault.partition(" ")[0]


def faults_of(device: str) -> set[str]:
    """All of the table, without the device's name."""
    return {row.fault.partition(" ")[2] for row in ROWS if device_of(row) == device}


def _cell(row: Row, step: str) -> Cell:
    after = f" after {row.after_s:g} s" if row.after_s else ""
    line = f"{row.begins} step == {step}{after}: {row.fault}" if row.fault else ""
    more = f", {row.markers} spheres" if row.markers != FEWEST else ""
    ends = frozenset(row.ends.split())
    more += "".join(f" {word}" for word in row.arms)
    return Cell((line or row.scene or row.answers) + more, line, step, ends - {DONE}, DONE in ends, row)


def noticed_by_device(codes: Iterable[str]) -> bool:
    """Whether one of these codes is of a device, which goes by the host's clock."""
    return any(code.startswith(DEVICE_CODES) for code in codes)


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


def codes_told(stop: Line) -> set[str]:
    """The code of the stop; where something was refused because of a fault, also the codes that it quotes."""
    code = str(stop.get("code", StepRefused.code))
    return {code, *CODE.findall(str(stop.get("unmet", stop.get("what"))))} if code in QUOTING else {code}
