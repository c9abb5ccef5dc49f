"""Exchange the stereo head for the guide, with the arm parked and its correction stream off."""

from __future__ import annotations

from procedures.engine.errors import WrongTool
from procedures.engine.step import Outcome, StepContext, StepSpec
from procedures.steps.link_health import link_payload
from procedures.steps.surroundings import surround_stereo_head
from ronna_hw.devices.readings import JointVector


def run(context: StepContext) -> Outcome:
    """Park, stop RSI, have the tool changed, then let the controller's inputs say what hangs there."""
    devices, calibration = context.devices, context.calibrations.tool_tip
    set_up = context.case.get("set_up")
    home: JointVector = tuple(set_up.payload["home_rad"])
    surround_stereo_head(context)
    devices.arm.move_joints(home)
    link = link_payload(context)
    devices.arm.deactivate()
    devices.stereo.deactivate()
    context.operator.change_tool(calibration.tool_number, "the surgical guide")
    context.confirm("the tool has been exchanged", f"the surgical guide, tool {calibration.tool_number}")
    mounted = devices.arm.read_tool_identity().number
    if mounted != calibration.tool_number:
        raise WrongTool("the guide is not mounted", expected=str(calibration.tool_number), got=str(mounted))
    context.confirm(
        "tip calibration of the guide",
        f"{calibration.identifier}, made {calibration.created:%Y-%m-%d}, "
        f"stated error {calibration.stated_error_mm:.2f} mm",
    )
    return Outcome(
        payload={"tool_number": mounted, "calibration": calibration.identifier, "link": link},
        parents=(set_up,),
        summary=f"tool {mounted} mounted",
    )


STEP = StepSpec(
    "tool_change",
    "Exchange the stereo head for the guide",
    needs=("set_up",),
    needs_all_trajectories=("registration",),
    run=run,
    moves=True,
)
