"""Manual tasks in an operating room, with the same names in procedures and simulated rooms."""

from __future__ import annotations

from enum import StrEnum

DEPTH_STOP = "depth_stop"  # set it: one number, tip to stop in mm; the scale is read
SKIN = "skin"
DRILL = "drill"
DURA = "dura"
INSERT = "insert"  # the instrument, up to its stop
HOLDER = "holder"  # put the instrument into the assistant's holder, its stop against the clamp, and close it
TEST_WEIGHT = "test_weight"  # hang it on that holder's clamp: its mass in kg; 0: take it off again
EMPTY = "empty"  # take the instrument, or the drill, out of that holder
DRILL_HOLDER = "drill_holder"  # put the drill there: one number, tip to stop in mm, which is read
TURN_DRILL = "turn_drill"  # switch it on
REST_DRILL = "rest_drill"  # and off
SEATED = "seated"  # look whether the stop rests on the guide; the gap in mm is read
OUT = "out"  # take the instrument out of the guide, or the divot from it
HEAD_CLAMP = "head_clamp"  # clamp the head, and lock the clamp to the table
SCAN = "scan"  # scan the clamped head with its spheres, and export the series into the case
CART_PLACE = "cart_place"  # wheel the cart to its place
CART_LOCK = "cart_lock"  # apply its brakes
CART_PUSH = "cart_push"  # lean on the locked cart from each side
DIALS = "dials"  # of the calibration stand: raise the divot to the tip, read its x, y and z
GAUGE = "gauge"  # read it: the arm's joints at it in deg, and the height between its dials in mm
TOUCH = "touch"  # the head with a pointer, in a direction from its middle, LPS; x, y, z in $ROBROOT are read
MEASURE = "measure"  # the same by a tape from the base, roughly
SITE_MARK = "site_mark"  # touch the mark of a trajectory on the patient's skin; x, y, z in $ROBROOT are read

TASKS = (
    DEPTH_STOP,
    SKIN,
    DRILL,
    DURA,
    INSERT,
    HOLDER,
    TEST_WEIGHT,
    EMPTY,
    DRILL_HOLDER,
    TURN_DRILL,
    REST_DRILL,
    SEATED,
    OUT,
    HEAD_CLAMP,
    SCAN,
    CART_PLACE,
    CART_LOCK,
    CART_PUSH,
    DIALS,
    GAUGE,
    TOUCH,
    MEASURE,
    SITE_MARK,
)


class OnStand(StrEnum):
    """Objects for the calibration stand: the ball, or the divot on a slide with three dials."""

    NOTHING = "nothing"
    BALL = "ball"
    DIVOT = "divot"
