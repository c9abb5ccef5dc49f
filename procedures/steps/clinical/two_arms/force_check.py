"""Check of the assistant's force sensor by a known weight, before it drills.

The weight hangs where the drill is put, with the axis of the drill near the vertical, so what it shows is the
scale of the force along that axis. What hanging it changes is compared in all directions: a wrong sign, axes
that are wired the wrong way round, a dead one and a wrong unit show as well. Bias has no part in it.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np

from procedures.engine.context import StepContext
from procedures.journal.errors import GateFailed
from procedures.operator.question import Task
from procedures.planning.errors import NotReachable
from procedures.workcell.assistant import Assistant
from ronna_hw.arrays import Array
from ronna_hw.text import format_against_limit
from ronna_hw.vectors import JointVector, joint_vector
from ronna_hw.wire.room_tasks import TEST_WEIGHT

WEIGHT_KG = 2.0  # two thirds of the force at which a drill is stopped; small arms carry it
GRAVITY_M_S2 = 9.81  # at 45 degrees of latitude; elsewhere 0.3 % at most
WEIGHT_N = WEIGHT_KG * GRAVITY_M_S2
# Safety against a force sensor of a wrong scale (U).
WRONG_BY_N = 1.0  # two standard errors of a change of the force of a sensor that is good enough to drill by
LEAST_UPRIGHT = math.cos(math.radians(30.0))  # of the drill's axis: the share of the weight along it

STILL_S = 2.0  # for the weight to stop swinging, and the force to be smoothed
TURN_STEP_RAD = math.radians(30.0)
TURNS = range(-5, 7)  # by those steps, of the last two joints


def require_true_force(context: StepContext) -> None:
    """Have a known weight hung on the assistant's empty holder, and taken off again, with the arm at home.

    Raises PRO-007 if the force does not show it, or does not come back, and PLAN-007 if the arm cannot turn
    the axis of the drill upright.
    """
    workcell, assistant = context.workcell, context.workcell.assistant
    context.progress(0.66, "the assistant turns its clamp upright for the test weight")
    upright_rad = _find_upright(assistant)
    workcell.start()
    assistant.settle(upright_rad)
    before_N = _read_force(context)
    _change_weight(context, WEIGHT_KG, f"hang the test weight of {WEIGHT_KG:g} kg on the assistant's clamp")
    loaded_N = _read_force(context)
    _change_weight(context, 0.0, "take the test weight off the assistant's clamp")
    after_N = _read_force(context)
    assistant.return_home()
    shown_N = loaded_N - (before_N + after_N) / 2.0
    _judge(context, shown_N, float(np.linalg.norm(after_N - before_N)))
    context.find(
        f"the assistant's force sensor shows a weight of {WEIGHT_N:.1f} N as {-shown_N[2]:.1f} N, and "
        f"{math.hypot(*shown_N[:2]):.1f} N across"
    )


def _find_upright(assistant: Assistant) -> JointVector:
    """Return a posture of the wrist with the drill's axis near the vertical, clear and on a clear way."""
    *arm_rad, fifth_rad, sixth_rad = assistant.joints_rad()
    turned = [
        joint_vector([*arm_rad, fifth_rad + one * TURN_STEP_RAD, sixth_rad + other * TURN_STEP_RAD])
        for one, other in sorted(product(TURNS, TURNS), key=lambda turns: (max(map(abs, turns)), turns))
    ]
    for joints_rad in turned:
        if (
            _upright_share(assistant, joints_rad) >= LEAST_UPRIGHT
            and assistant.rests_clear(joints_rad, 0.0)
            and not assistant.explain_blocked([assistant.settle_motion(joints_rad)], assistant.joints_rad())
        ):
            return joints_rad
    raise NotReachable(
        "no turn of the assistant's wrist at home holds the axis of the drill upright for the test weight",
        limit=f"{math.degrees(math.acos(LEAST_UPRIGHT)):.0f} degrees from the vertical",
        action="Give the assistant another home, with room around its clamp, and set up again; or drill by "
        "hand.",
    )


def _upright_share(assistant: Assistant, joints_rad: JointVector) -> float:
    """Return the share of a weight that acts along the axis of the drill, in a base that stands level."""
    clamp = assistant.flange_pose(joints_rad) @ assistant.flange_from_clamp
    return abs(float(clamp.rotation_matrix[2, 2]))


def _change_weight(context: StepContext, mass_kg: float, subject: str) -> None:
    wait = ", keep hands and cables off it, and wait until it hangs still" if mass_kg else ""
    context.perform_task(Task(TEST_WEIGHT, f"{subject}{wait}", context.trajectory, (mass_kg,)))


def _read_force(context: StepContext) -> Array:
    """Return the force (3,) on the holder at rest. Raises PRO-007 if the sensor sends none."""
    context.workcell.clock.sleep(STILL_S)
    force_N = np.array(context.workcell.assistant.read_force_N() or (math.nan,) * 3)
    if not np.isfinite(force_N).all():
        raise GateFailed(
            "the assistant's force sensor sends nothing",
            expected="three forces",
            action="Take the test weight off, and send the arms home. Have the sensor looked at, or drill by "
            "hand.",
        )
    return force_N


def _judge(context: StepContext, shown_N: Array, moved_N: float) -> None:
    """Raise PRO-007 unless a change of the force is that of the weight, and goes away with it."""
    off_N = float(np.linalg.norm(shown_N - (0.0, 0.0, -WEIGHT_N)))
    x, y, z = shown_N.tolist()
    for wrong_N, what in (
        (off_N, f"a weight of {WEIGHT_N:.1f} N as x {x:+.1f}, y {y:+.1f}, z {z:+.1f} N in its base"),
        (moved_N, "another force with the weight taken off than before it was hung"),
    ):
        if not wrong_N <= WRONG_BY_N:
            raise GateFailed(
                f"at {context.trajectory} the assistant's force sensor shows {what}",
                limit=f"{WRONG_BY_N:g} N from it",
                got=f"{format_against_limit(wrong_N, WRONG_BY_N, 1)} N",
                action="The drill is not in the holder, and nothing moves. Repeat the step if a hand or a "
                "cable touched the weight, or it was not hung; otherwise have the scale and wiring of the "
                "sensor checked, and drill by hand.",
            )
