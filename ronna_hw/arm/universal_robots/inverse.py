"""Closed-form inverse kinematics of an arm with three parallel axes and an offset wrist.

The base joint follows from the distance of the wrist 2 axis from the plane of the arm (two sides), wrist 2
and wrist 3 from the direction of that plane's normal in the flange (two flips), and the three parallel joints
are a planar chain of two links with a given end direction (two bends of the elbow).

In the plane, u points ahead, up along z, and n = u x up is the direction of the parallel axes. After wrist 1
the x axis is (cos psi, sin psi) and the wrist 2 axis (sin psi, -cos psi), psi the sum of the three.
"""

from __future__ import annotations

from itertools import product
from math import atan2, copysign, cos, degrees, hypot, sin, sqrt, tau

from ronna_hw.arm.errors import OutOfJointRange, Singular, Unreachable
from ronna_hw.arm.kinematics import RANGE_SLACK_RAD, Branch, Solution
from ronna_hw.arm.pose import Pose
from ronna_hw.arm.universal_robots.geometry import Dimensions
from ronna_hw.text import format_distinct
from ronna_hw.vectors import JointVector

AXIS_NAMES = ("base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3")
SINGULAR_SINE = 1e-7  # of wrist 2: below this, rounding decides how wrist 1 and wrist 3 share a turn
SINGULAR_AHEAD_MM = 1e-3  # the wrist 3 axis on the base axis, seen along the parallel axes
STRETCH_COSINE = 5e-13  # one minus the cosine of 1e-6 rad: the two bends of the elbow coincide
STRETCH_SLACK, NEARLY_COSINE = 0.02, 5e-7  # of a guess: 4 mm of reach, a bend of 1e-3 rad
AHEAD_SLACK_MM2, NEARLY_AHEAD_MM2 = 800.0, 1.0  # of a guess: 3 mm beside the axis, 1 mm ahead of it

# Bits of the branch:
BEHIND = 1  # the wrist is behind the base axis
BENT_BACK = 2  # sine of the elbow negative
TURNED = 4  # sine of wrist 2 negative
BRANCHES = tuple(
    Branch(BEHIND * behind + BENT_BACK * bent_back + TURNED * turned)
    for behind, bent_back, turned in product((0, 1), (1, 0), (0, 1))
)


def ahead_mm(arm: Dimensions, joints_rad: JointVector) -> float:
    """Return the signed distance of the wrist 3 axis from the base axis in the plane of the arm, mm."""
    _, q2, q3, q4, _, _ = joints_rad
    return arm.a2_mm * cos(q2) + arm.a3_mm * cos(q2 + q3) + arm.d5_mm * sin(q2 + q3 + q4)


def branch_of(arm: Dimensions, joints_rad: JointVector) -> Branch:
    """Return the branch of a joint vector."""
    behind, bent_back = ahead_mm(arm, joints_rad) < 0.0, sin(joints_rad[2]) < 0.0
    return Branch(BEHIND * behind + BENT_BACK * bent_back + TURNED * (sin(joints_rad[4]) < 0.0))


def closed_form(arm: Dimensions, pose: Pose, branch: Branch, guess: bool = False) -> JointVector:
    """Return the joint angles of a branch, up to whole turns. Raises ARM-001 or ARM-002.

    A `guess`, for iterations, may lie a few mm out of reach: elbow or base are taken nearly at their limit.
    """
    (px, py, pz), r, d4 = pose.position_mm, pose.rotation, arm.d4_mm
    x, y = px - arm.d6_mm * r[2], py - arm.d6_mm * r[5]
    square = x * x + y * y - d4 * d4
    if guess and -AHEAD_SLACK_MM2 < square < NEARLY_AHEAD_MM2:
        square = NEARLY_AHEAD_MM2
    if abs(square) < SINGULAR_AHEAD_MM * SINGULAR_AHEAD_MM:
        raise Singular("the wrist is beside the base axis", limit=f"{SINGULAR_AHEAD_MM} mm ahead of it")
    if square < 0.0:
        got, limit = format_distinct(hypot(x, y), d4, 1)
        raise Unreachable(
            "the wrist is too close to the base axis", limit=f"at least {limit} mm", got=f"{got} mm"
        )
    ahead = -sqrt(square) if branch & BEHIND else sqrt(square)
    q1 = atan2(ahead * y + d4 * x, ahead * x - d4 * y)
    c1, s1 = cos(q1), sin(q1)

    # Components along n of the flange's axes: x is c6 s5, y is -s6 s5, z is c5.
    xn, yn, c5 = r[0] * s1 - r[3] * c1, r[1] * s1 - r[4] * c1, r[2] * s1 - r[5] * c1
    if (s5 := hypot(xn, yn)) < SINGULAR_SINE:
        raise Singular(
            "wrist 1 and wrist 3 are in line", limit=f"wrist 2 {SINGULAR_SINE} rad", got=f"{s5:.2e} rad"
        )
    if branch & TURNED:
        s5 = -s5
    q5, q6 = atan2(s5, c5), atan2(-yn / s5, xn / s5)

    # The direction of wrist 1's x axis in the plane, from the flange's.
    c6, s6 = xn / s5, -yn / s5
    zu = r[2] * c1 + r[5] * s1
    cp = c5 * (c6 * (r[0] * c1 + r[3] * s1) - s6 * (r[1] * c1 + r[4] * s1)) - s5 * zu
    sp = c5 * (c6 * r[6] - s6 * r[7]) - s5 * r[8]
    a2, a3, d5, d6 = arm.a2_mm, arm.a3_mm, arm.d5_mm, arm.d6_mm
    wrist_u = px * c1 + py * s1 - d6 * zu - d5 * sp
    wrist_up = pz - arm.d1_mm - d6 * r[8] + d5 * cp
    c3 = (wrist_u * wrist_u + wrist_up * wrist_up - a2 * a2 - a3 * a3) / (2.0 * a2 * a3)
    excess = abs(c3) - 1.0
    if guess and -STRETCH_COSINE < excess < STRETCH_SLACK:
        c3, excess = copysign(1.0 - NEARLY_COSINE, c3), -NEARLY_COSINE
    if excess > STRETCH_COSINE:
        shortest_mm, longest_mm, wrist_mm = abs(a2 - a3), abs(a2 + a3), hypot(wrist_u, wrist_up)
        got, limit = format_distinct(wrist_mm, longest_mm if c3 > 0.0 else shortest_mm, 1)
        raise Unreachable(
            "wrist 1 is too far from the shoulder" if c3 > 0.0 else "wrist 1 is too close to the shoulder",
            limit=f"{'at most' if c3 > 0.0 else 'at least'} {limit} mm",
            got=f"{got} mm",
        )
    if excess > -STRETCH_COSINE:
        raise Singular("the elbow is stretched or folded flat", limit="a bend of 1e-6 rad")
    s3 = -sqrt(1.0 - c3 * c3) if branch & BENT_BACK else sqrt(1.0 - c3 * c3)
    q3 = atan2(s3, c3)
    q2 = atan2(wrist_up, wrist_u) - atan2(a3 * s3, a2 + a3 * c3)
    return (q1, q2, q3, atan2(sp, cp) - q2 - q3, q5, q6)


def solutions(arm: Dimensions, angles: list[Solution]) -> tuple[Solution, ...]:
    """Return every whole turn within range of the branches' angles. Raises ARM-003 if there is none."""
    found = []
    for branch, joints in angles:
        choices = []
        for q, low, high in zip(joints, arm.lower_rad, arm.upper_rad, strict=True):
            q -= tau * round(q / tau)
            turns = (q, q - tau, q + tau)
            choices.append([one for one in turns if low - RANGE_SLACK_RAD <= one <= high + RANGE_SLACK_RAD])
        found += [Solution(branch, (a, b, c, d, e, f)) for a, b, c, d, e, f in product(*choices)]
    if not found:
        raise OutOfJointRange("the pose is within reach, but every branch is outside the joint ranges")
    return tuple(found)


def nearest_turns(arm: Dimensions, joints_rad: JointVector, near: JointVector) -> JointVector:
    """Shift each joint by whole turns to the angle within range nearest to `near`. Raises ARM-003."""
    result = []
    for axis, (q, close) in enumerate(zip(joints_rad, near, strict=True)):
        low, high = arm.lower_rad[axis] - RANGE_SLACK_RAD, arm.upper_rad[axis] + RANGE_SLACK_RAD
        q += tau * round((close - q) / tau)
        if q > high:
            q -= tau
        elif q < low:
            q += tau
        if not low <= q <= high:
            raise OutOfJointRange(
                f"{AXIS_NAMES[axis]} would leave its range",
                limit=f"{degrees(low):.1f} to {degrees(high):.1f} deg",
                got=f"{degrees(q):.3f} deg",
            )
        result.append(q)
    a, b, c, d, e, f = result
    return (a, b, c, d, e, f)
