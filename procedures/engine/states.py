"""Names of case states between steps; `machine` adds the states of steps."""

from procedures.operator.checkpoint import PAUSED, SUSPENDED

RECOVERY, IDLE, HELD = "recovery", "idle", "held"
FINISHED, ABORTED = "finished", "aborted"
RESTS = (PAUSED, SUSPENDED)
ENDS = (FINISHED, ABORTED)
# What may be between steps, beside the step's own state, and what it means to a reader of the chart.
BETWEEN = {
    RECOVERY: "after a restart: nothing moves until devices have been re-read and the operator has accepted",
    IDLE: "nothing has started",
    HELD: "a step failed or was left: the arm is at rest, every result remains valid",
    PAUSED: "the operator paused the case",
    SUSPENDED: "a guard waits for its condition to be restored",
}
