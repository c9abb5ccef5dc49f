"""At the target: the arm rests; what the controller reports is compared with what was commanded."""

from __future__ import annotations

import numpy as np

from procedures.engine.errors import GateFailed
from procedures.engine.step import Outcome, StepContext, StepSpec
from procedures.steps.arm_frames import guide_in_flange, tool_pose
from procedures.steps.payloads import pose_from, pose_payload

POSITION_LIMIT_MM = 0.05  # nominal tip against the commanded one; more means the arm did not arrive
DWELL_S = 0.5  # of theatre time, before the reading


def run(context: StepContext) -> Outcome:
    """Read the arm at rest and record where the tip is as far as the controller knows."""
    positioning = context.result("positioning")
    context.clock.sleep(DWELL_S)
    reading = context.devices.arm.read_state()
    reached = tool_pose(context, reading.joints_rad, guide_in_flange(context))
    wanted = pose_from(positioning.payload["tool_pose"])
    error_mm = float(np.linalg.norm(reached.translation_mm - wanted.translation_mm))
    if error_mm > POSITION_LIMIT_MM:
        raise GateFailed(
            "the arm is not where it was sent", limit=f"{POSITION_LIMIT_MM} mm", got=f"{error_mm:.3f} mm"
        )
    return Outcome(
        payload={"tool_pose": pose_payload(reached), "nominal_error_mm": error_mm},
        parents=(positioning,),
        summary=f"nominal tip within {error_mm:.4f} mm of the command",
    )


STEP = StepSpec("at_target", "Hold at the target", needs=("positioning",), run=run, per_trajectory=True)
