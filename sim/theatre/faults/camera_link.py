"""Faults of the cameras themselves: stream, control channel, triggers and clocks, lens."""

from __future__ import annotations

from collections.abc import Iterator

from sim.theatre.faults.kinds import WHOLE_PERCENT, Arguments, FaultKind
from sim.theatre.scene.model import Scene

BOTH = "both"
WHICH = ("left", "right", BOTH)
SMALLEST_PATH_BYTES = 68  # the least that a network may carry
MOST_SPOTS = 500


def _which(arguments: Arguments, _scene: Scene) -> Iterator[str]:
    if arguments[0] not in WHICH:
        yield f"there is no camera {arguments[0]!r}, only {', '.join(WHICH)}"


def _which_and_share(arguments: Arguments, scene: Scene) -> Iterator[str]:
    yield from _which(arguments, scene)
    if float(arguments[1]) > WHOLE_PERCENT:
        yield f"{arguments[1]} % is more than 100 %"


def _which_and_path(arguments: Arguments, scene: Scene) -> Iterator[str]:
    yield from _which(arguments, scene)
    if int(arguments[1]) < SMALLEST_PATH_BYTES:
        yield f"{arguments[1]} bytes is less than any network carries: {SMALLEST_PATH_BYTES}"


def _which_and_spots(arguments: Arguments, scene: Scene) -> Iterator[str]:
    yield from _which(arguments, scene)
    if int(arguments[1]) > MOST_SPOTS:
        yield f"{arguments[1]} spots are more than can be drawn: {MOST_SPOTS}"


def _lasting(name: str, phrase: str, meaning: str) -> FaultKind:
    return FaultKind(f"camera_{name}", "camera", phrase, meaning, check=_which)


def _share(name: str, phrase: str, meaning: str) -> FaultKind:
    return FaultKind(f"camera_{name}", "camera", phrase, meaning, check=_which_and_share)


def _once(name: str, phrase: str, meaning: str) -> FaultKind:
    return FaultKind(f"camera_{name}", "camera", phrase, meaning, momentary=True, check=_which)


STREAM_FAULTS = (
    _share(
        "lose", "lose NAME NUMBER %", "That share of one camera's image packets is lost (left, right, both)."
    ),
    _lasting("forget", "forget NAME", "Packets are not resent: a request is answered with 0x800C."),
    _lasting("omit_leader", "omit leader NAME", "The first packet (leader) of every image is lost."),
    _lasting("omit_trailer", "omit trailer NAME", "The last packet (trailer) of every image is lost."),
    _lasting("omit_frames", "omit frames NAME", "Every packet of every image is lost; they can be resent."),
    _lasting("shuffle", "shuffle NAME", "The packets of an image arrive out of order."),
    _share("duplicate", "duplicate NAME NUMBER %", "That share of the image packets arrives twice."),
    _lasting("shift_area", "shift area NAME", "The leader reports an area 16 px beside the configured one."),
    _lasting("truncate", "truncate NAME", "Images carry only half their data."),
    FaultKind(
        "camera_path",
        "camera",
        "narrow path NAME INT bytes",
        "The network drops larger stream packets.",
        check=_which_and_path,
    ),
)
CONTROL_FAULTS = (
    _lasting("unplug", "unplug NAME", "Nothing reaches the camera or leaves it."),
    _lasting("deaf", "ignore heartbeat NAME", "Commands do not refresh the heartbeat: control lapses."),
    _lasting("taken", "seize NAME", "Another application has control."),
    _lasting("delay_answers", "delay answers NAME INT ms", "Acknowledgements are delayed by that time."),
    _lasting(
        "pend_answers", "announce answers NAME INT ms", "The same, each announced at once by a PENDING_ACK."
    ),
    _share("lose_answers", "lose answers NAME NUMBER %", "That share of the acknowledgements is lost."),
    _share("lose_events", "lose events NAME NUMBER %", "That share of the event messages is lost."),
    _once("restart", "restart NAME", "The camera restarts: power-on settings, no application in control."),
)
TRIGGER_FAULTS = (
    _lasting("miss", "miss triggers NAME", "Triggers have no effect and are not counted."),
    _lasting("late", "expose late NAME NUMBER ms", "The exposure starts that long after its trigger."),
    _lasting("drift", "drift NAME SIGNED ppm", "The time stamp counter runs fast by that much."),
    _once("reset_clock", "reset clock NAME", "The time stamp counter restarts at zero."),
    FaultKind(
        "camera_pulse",
        "camera",
        "pulse line",
        "Not a fault: a pulse on the trigger line of both cameras (TriggerSource Line1).",
        momentary=True,
    ),
)
LENS_FAULTS = (
    _lasting("saturate", "saturate NAME", "Far too much light: every pixel saturates."),
    _lasting("darken", "darken NAME", "No light: only noise remains."),
    _lasting("defocus", "defocus NAME NUMBER px", "The whole image is blurred with that standard deviation."),
    FaultKind(
        "camera_dust",
        "camera",
        "dust NAME INT spots",
        "That many dark spots on the sensor, at the same places in every image.",
        check=_which_and_spots,
    ),
)
DEVICE_FAULTS = (*STREAM_FAULTS, *CONTROL_FAULTS, *TRIGGER_FAULTS, *LENS_FAULTS)
