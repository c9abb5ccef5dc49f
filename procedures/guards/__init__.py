"""Conditions that must hold while the arm works, besides those monitored by the devices.

Guards are asked at every checkpoint: before each motion and with every progress report of a step. An unmet
condition suspends the case with a reason in plain words, until it is met or the operator leaves the step.
"""

from procedures.guards.default_guards import UnchangedRecords, case_guards, patient_watch
from procedures.guards.guide_displacement import GuideDisplacement
from procedures.guards.tracker_guards import HeadInSight, TrackerLink

__all__ = [
    "GuideDisplacement",
    "HeadInSight",
    "TrackerLink",
    "UnchangedRecords",
    "case_guards",
    "patient_watch",
]
