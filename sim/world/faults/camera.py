"""Camera fault kinds: view, stream, control channel, triggers and clocks, lens."""

from __future__ import annotations

from collections.abc import Iterator

from sim.world.faults.fault import (
    Arguments,
    FaultKinds,
    OneOf,
    check_at_most,
    fiducial_number,
)
from sim.world.scene.model import Scene

BOTH = "both"
SMALLEST_PATH_BYTES = 68  # least packet size that a network must carry
BRIGHTEST_LAMP_PERCENT = 1000.0  # saturates at any exposure in use
MOST_STAINED_PERCENT = 60.0  # spots overlap: more would take long and look alike

SIGHT = FaultKinds("camera")
PAIR = FaultKinds("camera", prefix="camera_")
CAMERA = FaultKinds("camera", prefix="camera_", first=OneOf("camera", ("left", "right", BOTH)))
declare_lasting, declare_momentary = CAMERA.declare_lasting, CAMERA.declare_momentary
_side = OneOf("camera", ("left", "right"))


def _check_path(arguments: Arguments, _scene: Scene) -> Iterator[str]:
    if int(arguments[1]) < SMALLEST_PATH_BYTES:
        yield f"expected at least {SMALLEST_PATH_BYTES} bytes, got {arguments[1]}"


TWIST = SIGHT.declare_lasting(
    "twist",
    "twist NAME SIGNED deg",
    "The left or right camera is rotated by that angle in its mount, in the plane of both cameras.",
    _side,
)
SIGHT_FAULTS = (
    SIGHT.declare_lasting(
        "stain",
        "stain marker INT NUMBER %",
        "Spots of blood cover that share of a fiducial's film.",
        fiducial_number,
        check_at_most(MOST_STAINED_PERCENT, "%", argument=1),
    ),
    SIGHT.declare_lasting(
        "glare",
        "glare NAME NUMBER px",
        "A lamp reflects into the image of the left or right camera, with that radius.",
        _side,
    ),
    SIGHT.declare_lasting(
        "occluder",
        "occlude NAME NUMBER %",
        "A straight edge hides that share of the sphere's rim from the left or right camera.",
        _side,
    ),
    TWIST,
    SIGHT.declare_lasting(
        "creep",
        "creep NAME SIGNED deg per min",
        "The left or right camera keeps rotating in its mount at that rate, in the plane of both cameras.",
        _side,
    ),
)
STREAM_FAULTS = (
    PAIR.declare_lasting("drop", "drop NUMBER %", "That share of the image packets is lost."),
    declare_lasting(
        "lose", "lose NAME NUMBER %", "That share of one camera's image packets is lost (left, right, both)."
    ),
    declare_lasting("forget", "forget NAME", "Packets are not resent: a request is answered with 0x800C."),
    declare_lasting("omit_leader", "omit leader NAME", "The first packet (leader) of every image is lost."),
    declare_lasting("omit_trailer", "omit trailer NAME", "The last packet (trailer) of every image is lost."),
    declare_lasting(
        "omit_frames", "omit frames NAME", "Every packet of every image is lost; they can be resent."
    ),
    declare_lasting("shuffle", "shuffle NAME", "The packets of an image arrive out of order."),
    declare_lasting("duplicate", "duplicate NAME NUMBER %", "That share of the image packets arrives twice."),
    declare_lasting(
        "shift_area", "shift area NAME", "The leader reports an area 16 px off the configured one."
    ),
    declare_lasting("truncate", "truncate NAME", "Images contain only half of their data."),
    declare_lasting(
        "path", "narrow path NAME INT bytes", "The network drops larger stream packets.", _check_path
    ),
)
OUTPUT_FAULTS = (
    SIGHT.declare_lasting(
        "lamp",
        "lamp NUMBER %",
        "A lamp lights the skin with that share of the light that a sphere returns.",
        check_at_most(BRIGHTEST_LAMP_PERCENT, "%"),
    ),
    SIGHT.declare_lasting(
        "hand", "hand NUMBER mm", "A hand is in the projector's line, its middle that far over the skin."
    ),
    declare_lasting("hold_line", "hold line NAME", "The output line stays low, whatever its source."),
    SIGHT.declare_lasting(
        "no_laser", "projector dark", "The line projector stays dark although its line is high."
    ),
)
CONTROL_FAULTS = (
    declare_lasting("unplug", "unplug NAME", "No packets reach or leave the camera."),
    declare_lasting(
        "deaf", "ignore heartbeat NAME", "Commands do not refresh the heartbeat: control lapses."
    ),
    declare_lasting("taken", "seize NAME", "Another application has control."),
    declare_lasting(
        "delay_answers", "delay answers NAME INT ms", "Acknowledgements are delayed by that time."
    ),
    declare_lasting(
        "pend_answers",
        "announce answers NAME INT ms",
        "Acknowledgements are delayed by that time, each announced immediately by a PENDING_ACK.",
    ),
    declare_lasting(
        "lose_answers", "lose answers NAME NUMBER %", "That share of the acknowledgements is lost."
    ),
    declare_lasting("lose_events", "lose events NAME NUMBER %", "That share of the event messages is lost."),
    declare_momentary(
        "restart", "restart NAME", "The camera restarts: power-on settings, no application in control."
    ),
)
TRIGGER_FAULTS = (
    declare_lasting("miss", "miss triggers NAME", "Triggers have no effect and are not counted."),
    declare_lasting("late", "expose late NAME NUMBER ms", "The exposure starts that long after its trigger."),
    declare_lasting("drift", "drift NAME SIGNED ppm", "The time stamp counter runs fast by that much."),
    declare_momentary("reset_clock", "reset clock NAME", "The time stamp counter restarts at zero."),
    PAIR.declare_momentary(
        "pulse",
        "pulse line",
        "Not a fault: a pulse on the trigger line of both cameras (TriggerSource Line1).",
    ),
)
LENS_FAULTS = (
    declare_lasting("saturate", "saturate NAME", "Overexposure: every pixel saturates."),
    declare_lasting("darken", "darken NAME", "No light: only noise remains."),
    declare_lasting(
        "defocus", "defocus NAME NUMBER px", "The whole image is blurred with that standard deviation."
    ),
    declare_lasting(
        "dust",
        "dust NAME INT spots",
        "That many dark spots on the sensor, at the same places in every image.",
    ),
)
CAMERA_FAULTS = (
    *SIGHT_FAULTS,
    *STREAM_FAULTS,
    *CONTROL_FAULTS,
    *OUTPUT_FAULTS,
    *TRIGGER_FAULTS,
    *LENS_FAULTS,
)
