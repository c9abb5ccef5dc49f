"""The table of what stayed as it was says by what head and cart are watched, also with few spheres."""

from __future__ import annotations

import pytest

from procedures.guards.stability import Subject, tell_unseen_slip, watched_subjects
from procedures.planning.plan_model import FiducialKind
from procedures.steps.catalogue import clinical_steps

BOTH = "on it and the frame on its clamp, by the tracker"
FEW = "; while the arm moves, by the frame alone"


@pytest.mark.parametrize(
    ("spheres", "kind", "seen_by"),
    [
        (None, FiducialKind.FREE, "the spheres on it, by the tracker"),
        (0, FiducialKind.SURFACE, "the frame on its clamp, by the tracker"),
        (1, FiducialKind.MIXED, f"the sphere {BOTH}{FEW}"),
        (2, FiducialKind.MIXED, f"the spheres {BOTH}{FEW}"),
        (3, FiducialKind.MIXED, f"the spheres {BOTH}"),
    ],
)
def test_what_a_head_is_seen_by_and_what_hangs_on_it_fit_its_fiducials(
    spheres: int | None, kind: FiducialKind, seen_by: str
) -> None:
    by_subject = {one.subject: one for one in watched_subjects(spheres)}
    head, cameras = by_subject[Subject.HEAD], by_subject[Subject.CAMERAS]
    assert head.seen_by == seen_by
    assert ("spheres" in cameras.seen_by) is (spheres != 0)
    assert {*head.hangs, *cameras.hangs} <= {one.name for one in clinical_steps(fiducials=kind)}


def test_a_slip_of_the_head_that_its_spheres_show_is_not_called_unseen() -> None:
    alone, one, two, three = map(tell_unseen_slip, range(4))
    assert "sees the frame alone" in alone
    assert "by less than its sphere shows, or turns about it" in one
    assert "by less than its spheres show, or turns about the line through them" in two
    assert three == ""
