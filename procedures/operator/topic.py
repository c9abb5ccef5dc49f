"""What the operator can be asked, by stable names."""

from __future__ import annotations

from enum import StrEnum


class Topic(StrEnum):
    """What can be asked in a case; with a trajectory where it belongs to one, such as `approach:T1`."""

    PATIENT = "patient"  # that this is the patient and the plan
    RESUME = "resume"  # what was found again after a restart
    FIRST_MOTION = "first_motion"  # since the devices were connected or a stop
    HEAD_CLAMPED = "head_clamped"  # and the clamp locked to the table
    CART_PLACE = "cart_place"  # the cart stands elsewhere than its place was proposed
    CART_LOCKED = "cart_locked"  # its brakes are closed
    CART_MOVED = "cart_moved"  # or the tracker, after the localization: the case goes on from there
    SPHERE_COUNT = "sphere_count"  # the CT shows another number than were implanted
    UNMATCHED_SPHERE = "unmatched_sphere"  # one is not where the CT has it, as the tracker sees
    UNREACHABLE = "reach"  # the arm cannot reach a trajectory
    SPHERE = "sphere"  # the stereo head cannot measure one
    MOVED_SPHERE = "moved_sphere"  # one alone explains why the fit disagrees
    MARGIN = "margin"  # the predicted error exceeds the plan's
    REGISTRATION = "registration"
    REGISTRATION_KEPT = "registration_kept"  # after the arm was in fault
    TOOL_CHANGE = "tool_change"
    TOOL_TIP = "tool_tip"
    TOOL_CHECK = "tool_check"  # of the mounted tool on a gauge
    APPROACH = "approach"  # over an entry, and along the axis to where the guide is held
    DEPTH_STOP = "depth_stop"  # of the instrument, as it was computed and set
    WORK_BEGUN = "work_begun"  # through the guide, when it was there before: from which stage it goes on
    SKIN = "skin"  # opened through the guide
    DRILL = "drill"  # the skull is drilled
    DURA = "dura"  # is opened
    AT_TARGET = "at_target"  # the instrument is at depth; the arm holds until this is answered
    INSTRUMENT_OUT = "instrument_out"  # of the guide: nothing moves before
    RETREAT = "retreat"
    PARK = "park"
    CALIBRATION = "calibration"
    PAUSE = "pause"
    GUARD = "guard"  # a guard suspends the step
    MOVE_FOLLOWED = "move_followed"  # the registration follows a measured move of the head
    HEAD_UNSEEN = "head_unseen"  # a guide is near a head that the tracker has not seen for too long
    REPEAT = "repeat"  # a step that is done: what a new result supersedes
    READING = "reading"  # what a dial or a gauge shows, typed at a console
    UNVERIFIED = "unverified"  # a controller that cannot say how it is set up


DELIBERATE = frozenset(
    {
        Topic.RESUME,
        Topic.FIRST_MOTION,
        Topic.REGISTRATION,
        Topic.REGISTRATION_KEPT,
        Topic.TOOL_CHECK,
        Topic.APPROACH,
        Topic.WORK_BEGUN,
        Topic.AT_TARGET,
        Topic.INSTRUMENT_OUT,
        Topic.RETREAT,
        Topic.PARK,
        Topic.CALIBRATION,
        Topic.PAUSE,
        Topic.HEAD_UNSEEN,
        Topic.MOVE_FOLLOWED,
        Topic.CART_MOVED,
        Topic.UNVERIFIED,
    }
)
# What no file answers on real devices: also what hands have done to the patient, though nothing moves then.
FOR_A_PERSON = DELIBERATE | {Topic.DEPTH_STOP, Topic.SKIN, Topic.DRILL, Topic.DURA}
