"""What must hold while the arm works, besides what the devices monitor themselves.

Guards are asked at every checkpoint: before each motion and whenever a step says how far it is. What is unmet
suspends the case with a reason in plain words, until it is met or the operator leaves the step.
"""

from procedures.guards.guide_still import GuideStill
from procedures.guards.standing import patient_watch, sight_guard, standing_guards
from procedures.guards.theatre_records import UnchangedRecords
from procedures.guards.tracker_link import TrackerLink

__all__ = [
    "GuideStill",
    "TrackerLink",
    "UnchangedRecords",
    "patient_watch",
    "sight_guard",
    "standing_guards",
]
