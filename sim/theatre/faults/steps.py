"""The steps of a procedure, as the operator names them at the control port."""

STEPS = (
    "ct_import",
    "fiducial_localization",
    "plan_check",
    "set_up",
    "global_localization",
    "correspondence",
    "path_check",
    "relocalization",
    "registration",
    "tool_change",
    "positioning",
    "at_target",
    "retreat",
)
