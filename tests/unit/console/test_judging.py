"""A draft judged with the arm of the mini theatre, first without clearance and then like the check."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from localized_spheres import localized_marker
from plan_editors import ENTRY, TARGET, scan
from recording_cell import mini_theatre_file

from console.planning.draft import Draft, DraftTrajectory
from console.planning.judging import Judgement, expected, judge, page_advice
from console.planning.reach_panel import tell_trajectories
from procedures.imaging.errors import MarkerCountWrong
from procedures.planning.errors import NO_TOOL_RECORD, NotReachable
from procedures.planning.plan_model import FiducialKind
from procedures.planning.pose_name import GAUGE, PoseKind, PoseName
from procedures.planning.theatre_arm import SixNumbers, TheatreArm, theatre_arm
from procedures.planning.visits import Unmet
from procedures.registration.surface.surface import Surface
from procedures.strategies.catalogue import find_strategy

NEAR: SixNumbers = (700.0, 0.0, 100.0, -90.0, 0.0, -90.0)
FAR: SixNumbers = (1500.0, 0.0, 250.0, -90.0, 0.0, -90.0)
CENTRES_MM = ((40.0, -40.0, 77.0), (-40.0, -45.0, 73.0), (0.0, -80.0, 47.0))
DRAFT = Draft(
    "HFS",
    implanted=3,
    instrument_length_mm=250.0,
    ways=(DraftTrajectory("T1", ENTRY, TARGET),),
    markers=tuple(localized_marker(centre, 0.01 * np.eye(3)) for centre in CENTRES_MM),
)


def arm_at(place: Path, robot_from_ct: SixNumbers) -> TheatreArm:
    file = mini_theatre_file(place, simulated=True)
    return theatre_arm(file, robot_from_ct, None, find_strategy("ocs"))


def test_a_plan_within_reach_is_judged_with_the_arms_own_errors(tmp_path: Path) -> None:
    theatre = arm_at(tmp_path, NEAR)
    quick = judge(DRAFT, scan(), theatre, thorough=False)
    assert (quick.findings, quick.thorough) == ((), False)
    assert quick.expected["T1"].with_arm
    assert "margin 2 mm: predicted within" in expected(quick, DRAFT)
    assert 'data-reached="T1"' in tell_trajectories(quick)
    alone = judge(DRAFT, scan(), None, thorough=True).expected["T1"]
    assert quick.expected["T1"].rms_mm > alone.rms_mm


@pytest.mark.slow
def test_the_thorough_look_refuses_what_is_within_reach_and_too_near_the_head(tmp_path: Path) -> None:
    judged = judge(DRAFT, scan(), arm_at(tmp_path, NEAR), thorough=True)
    assert judged.thorough
    assert "PLAN-007: T1/target" in " ".join(map(str, judged.findings))
    assert not judged.expected["T1"].with_arm


def test_a_target_out_of_reach_still_has_the_error_that_the_markers_alone_predict(tmp_path: Path) -> None:
    judged = judge(DRAFT, scan(), arm_at(tmp_path, FAR), thorough=False)
    assert [one for one in judged.unmet if one.pose.trajectory == "T1"]
    (line,) = re.findall(r'<li class="bad" data-unreached="T1">(.*?)</li>', tell_trajectories(judged))
    assert line.startswith("T1: not within reach. The ")
    assert not re.search(r"fiducial|standoff_mm|ARM-|ronna-|--", line), "the check's names, not a surgeon's"
    alone = judge(DRAFT, scan(), None, thorough=True)
    assert judged.expected == alone.expected
    assert not judged.expected["T1"].with_arm
    shown = expected(judged, DRAFT)
    assert re.search(r">T1, markers only: [\d.]+ mm rms, [\d.]+ mm at 95%</p>", shown)
    assert "margin 2" not in shown, "a part of the chain is judged against the margin of the whole"


UNMET = (
    Unmet(PoseName(PoseKind.FIDUCIALS, "T1"), "no orientation [STR-001]", "no orientation"),
    Unmet(PoseName(PoseKind.FIDUCIAL, "T1", 2), "out of range [ARM-003]", "out of range"),
    Unmet(PoseName(PoseKind.TARGET, "T2"), "too far [ARM-001]", "too far"),
    Unmet(
        PoseName(PoseKind.FIDUCIAL, "neutral orientation", 0), "sphere 2 is in front", "marker 2 is in front"
    ),
    Unmet(GAUGE, "too near [ARM-007]", "too near"),
)


def test_the_reach_is_told_in_a_surgeons_words() -> None:
    ways = tuple(DraftTrajectory(name, ENTRY, TARGET) for name in ("T1", "T2"))
    judged = Judgement(replace(DRAFT, ways=ways), unmet=UNMET, is_reach_known=True, complete=True)
    assert re.findall(r"<li.*?>(.*?)</li>", tell_trajectories(judged)) == [
        "T1: not within reach. The stereo head does not get to the markers: no orientation; "
        "nor to 1 more of its poses",
        "T2: not within reach. The guide does not get to the target: too far",
        "At marker 1: marker 2 is in front",
        "At the gauge: too near",
    ]


def test_advice_on_the_page_is_whole_and_names_no_command() -> None:
    whole = "Move the head; or choose a tool."
    assert page_advice(NotReachable("too far", action=whole)) == whole
    counted = page_advice(MarkerCountWrong("no marker found", candidates=()))
    assert counted.endswith("scan again, or correct the expected count.")
    assert page_advice(NO_TOOL_RECORD("none")).startswith("Ask whoever set up this planner")


def test_a_plan_on_the_skin_is_judged_by_skin_and_screws_against_its_margin() -> None:
    directions = np.random.default_rng(1).normal(size=(3000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    normals = directions / (75.0, 95.0, 90.0)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    skin = cast(Surface, SimpleNamespace(points_mm=directions * (75.0, 95.0, 90.0), normals=normals))
    on_skin = replace(DRAFT, fiducials=FiducialKind.MIXED, implanted=1, markers=DRAFT.markers[:1])
    judged = judge(on_skin, scan(), None, thorough=True, skin=skin)
    alone = judge(replace(on_skin, markers=DRAFT.markers), scan(), None, thorough=True, skin=skin)
    assert judged.expected["T1"].rms_mm > alone.expected["T1"].rms_mm
    shown = expected(judged, on_skin)
    assert "skin and 1 screw" in shown
    assert "margin 2 mm" in shown
