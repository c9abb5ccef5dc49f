"""A plan started from its CT: everything known from the series, with the trajectories left to the planner."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from procedures.planning.plan.model import FEWEST_MARKERS, MOST_MARKERS, SCHEMA_VERSION, PatientPosition

UNKNOWN_POSITION = f"# patient_orientation: not given by the series; one of {', '.join(PatientPosition)}"
TRAJECTORY = """
# One block for each trajectory, in the order in which they are meant to be done; take the # away.
# [[trajectories]]
# id = "T1"
# entry_mm = [0.0, 0.0, 0.0]   # where it enters the head
# target_mm = [0.0, 0.0, 0.0]  # where it ends
# free_angle_deg = 0.0         # of the guide about the axis
# margin_mm = 2.0              # largest target error that is accepted
"""


def new_plan(
    series_instance_uid: str, patient_position: str, spheres_mm: Sequence[Sequence[float]], source: str
) -> str:
    """The text of a plan on the series `source`, with its spheres (n, 3) LPS mm as a comment."""
    return "\n".join(_lines(series_instance_uid, patient_position, spheres_mm, source)) + TRAJECTORY


def _lines(
    series_instance_uid: str, patient_position: str, spheres_mm: Sequence[Sequence[float]], source: str
) -> Iterable[str]:
    yield f"# Created from the CT in {source}. Coordinates are LPS mm of that series."
    yield "# Every key: docs/reference/plan-file.md. Then: ronna-plan check PLAN --ct SERIES_DIR"
    yield f"schema = {SCHEMA_VERSION}"
    yield f'series_instance_uid = "{series_instance_uid}"'
    if patient_position in set(PatientPosition):
        yield f'patient_orientation = "{patient_position}"  # from the series'
    else:
        yield UNKNOWN_POSITION
    count = len(spheres_mm)
    known = FEWEST_MARKERS <= count <= MOST_MARKERS
    found = f"{count} found in the CT; count the screws on the patient"
    yield f"implanted = {count}  # {found}" if known else f"# implanted = ...  # {found}"
    yield 'fiducials = "free"  # or "xframe"'
    yield 'tool = "guide"'
    yield "standoff_mm = 30.0  # from the entry to the lower end of the guide, outside the skin"
    yield "# instrument_length_mm = 250.0  # from its tip to where a depth stop still holds"
    for number, centre in enumerate(spheres_mm, start=1):
        yield f"# sphere {number}: {', '.join(f'{value:.2f}' for value in centre)}"
