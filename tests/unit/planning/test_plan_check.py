"""A plan checked against its series, its fiducials and the arm."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from coded_errors import raises
from half_sitting import SIGHT
from scipy.spatial.transform import Rotation
from strategy_arms import Stuck

from procedures.planning import learning_looks
from procedures.planning.errors import (
    MARKERS_ADHESIVE,
    NOT_THE_FRAME,
    NOT_THE_TEMPLATE,
    OUTSIDE_FIELD,
    STOP_BEYOND_INSTRUMENT,
    WRONG_ORIENTATION,
    WRONG_SERIES,
    NotIntoHead,
    NotReachable,
    PlanMistakes,
    StandoffInsideSkin,
    UnknownTool,
)
from procedures.planning.plan_check import (
    check_plan,
    least_side_difference_mm,
    require_spheres,
    warn_of_ambiguity,
)
from procedures.planning.plan_file import read_plan
from procedures.planning.plan_model import FiducialKind
from procedures.strategies.catalogue import find_strategy
from ronna_hw.tool_record import GuideBore
from ronna_hw.x_frame import SPHERE_CENTRES_MM

FOUR = [[60.0, -40.0, 60.0], [-50.0, -45.0, 55.0], [5.0, 40.0, 80.0], [-60.0, 20.0, 70.0]]


@pytest.fixture
def plan(plan_text, plan_path):
    return read_plan(plan_path(plan_text))


def test_a_valid_plan_passes(plan, make_volume, make_arm):
    result = check_plan(plan, make_volume(), fiducials_mm=FOUR, arm=make_arm())
    assert result.passed
    assert result.findings == result.warnings == ()
    result.require()
    payload = json.loads(json.dumps(result.as_payload(), allow_nan=False))
    assert payload["passed"] is True
    assert [one["id"] for one in payload["trajectories"]] == ["T1", "T2"]


@pytest.mark.hazard(9)
def test_another_series_is_refused_with_both_uids(plan, make_volume):
    with raises(WRONG_SERIES, match="PLAN-003") as caught:
        check_plan(plan, make_volume(series_instance_uid="1.2.3.4")).require()
    assert plan.series_instance_uid in str(caught.value)
    assert "1.2.3.4" in str(caught.value)
    assert "mistyped" not in str(caught.value)
    other = ("2" if plan.series_instance_uid[0] == "1" else "1") + plan.series_instance_uid[1:]
    with raises(WRONG_SERIES, match=r"\(case/plan\.toml\), got 1\.2\.3\.4 \(scans/Monday\)"):
        check_plan(
            plan,
            make_volume(series_instance_uid="1.2.3.4"),
            plan_name="case/plan.toml",
            ct_name="scans/Monday",
        ).require()
    with raises(WRONG_SERIES, match="UID differs in character 1 only: mistyped"):
        check_plan(plan, make_volume(series_instance_uid=other)).require()


@pytest.mark.hazard(7)
def test_another_patient_position_is_refused(plan, make_volume):
    with raises(WRONG_ORIENTATION, match=r"PLAN-009.*HFS.*HFP"):
        check_plan(plan, make_volume(patient_position="HFP")).require()


def test_a_series_without_a_patient_position_is_warned_about(plan, make_volume):
    result = check_plan(plan, make_volume(patient_position=""))
    assert result.passed
    assert "left and right" in result.warnings[0]


def test_fiducials_away_from_the_template_are_refused(plan, make_volume):
    four = np.asarray(FOUR, dtype=float)
    as_planned = plan.model_copy(update={"template_mm": tuple(map(tuple, four[::-1] + 7.0))})
    assert check_plan(as_planned, make_volume(), fiducials_mm=four).passed
    another = plan.model_copy(update={"template_mm": tuple(map(tuple, 1.2 * four))})
    with raises(NOT_THE_TEMPLATE, match="PLAN-017"):
        check_plan(another, make_volume(), fiducials_mm=four).require()


def test_three_fiducials_with_nearly_equal_sides_are_warned_about(plan_text, plan_path, make_volume):
    plan = read_plan(plan_path(plan_text.replace("implanted = 4", "implanted = 3")))
    triangle = np.array([[0, 0, 0], [80, 0, 0], [41, 68, 0]])
    warnings = check_plan(plan, make_volume(), fiducials_mm=triangle).warnings
    assert any("displaced" in one for one in warnings)
    assert any("sides" in one for one in warnings)
    spread = np.array([[0, 0, 0], [80, 0, 0], [20, 110, 0]])
    assert not any("sides" in one for one in check_plan(plan, make_volume(), fiducials_mm=spread).warnings)


@pytest.mark.hazard(10)
def test_fiducials_with_a_symmetric_layout_are_warned_about(plan, make_volume):
    square = [[0, 0, 50], [90, 0, 50], [90, 90, 50], [0, 90, 50]]
    warnings = check_plan(plan, make_volume(), fiducials_mm=square).warnings
    assert warnings == ("the fiducials look alike from another side: 2 for 4, 4 for 2 could be mistaken",)


def test_all_findings_come_in_one_error(plan, make_volume):
    volume = make_volume(series_instance_uid="1.2.3.4", patient_position="FFS")
    result = check_plan(plan, volume, fiducials_mm=FOUR[:3])
    assert [one.code for one in result.findings] == ["PLAN-003", "PLAN-009", "PLAN-008"]
    with pytest.raises(PlanMistakes) as caught:
        result.require()
    for said in ("PLAN-003", "PLAN-009", r"PLAN-008.*expected 4.*3"):
        assert re.search(said, str(caught.value))


ENTRY, TARGET = "entry_mm = [10.0, -50.0, 60.0]", "target_mm = [5.0, -20.0, 20.0]"
EXCHANGED = {ENTRY: ENTRY.replace("entry", "target"), TARGET: TARGET.replace("target", "entry")}
IN_AIR = {ENTRY: "entry_mm = [10, -85, 90]", TARGET: "target_mm = [5, -80, 75]"}
REFUSED = {
    "outside": (
        {ENTRY: "entry_mm = [10, -20, 100.5]"},
        OUTSIDE_FIELD,
        r"PLAN-006.*entry of trajectory T1.*expected L -.* to .*; S .* mm",
    ),
    "exchanged": (EXCHANGED, NotIntoHead, "PLAN-011.*T1.*probably swapped"),
    "two points in air": (IN_AIR, NotIntoHead, "PLAN-011.*T1.*in air(?!.*probably)"),
    "entry deep inside": (
        {ENTRY: "entry_mm = [5, -35, 40]"},
        NotIntoHead,
        "PLAN-011.*T1.*in front of the entry",
    ),
    "unknown tool": ({'"guide"': '"drill"'}, UnknownTool, "PLAN-012.*guide.*drill"),
}


def edited(text: str, changes: dict[str, str]) -> str:
    """All changes at once, so that an exchange is one."""
    return re.sub("|".join(map(re.escape, changes)), lambda found: changes[found[0]], text)


@pytest.mark.parametrize("name", REFUSED)
def test_an_implausible_plan_is_refused(name, plan_text, plan_path, make_volume):
    changes, error, said = REFUSED[name]
    with raises(error, match=said):
        check_plan(read_plan(plan_path(edited(plan_text, changes))), make_volume()).require()


@pytest.mark.hazard(10)
def test_the_x_frame_is_recognised_among_the_spheres_of_the_ct(plan_text, plan_path, make_volume):
    plan = read_plan(plan_path(plan_text.replace('"free"', '"xframe"')))
    turned = Rotation.from_rotvec([0.3, -0.5, 0.9]).apply(SPHERE_CENTRES_MM) + np.array([0.0, 0.0, 60.0])
    check = check_plan(plan, make_volume(), fiducials_mm=np.vstack([[[70.0, 10.0, 0.0]], turned]))
    assert check.passed
    assert check.warnings == ("spheres that do not belong to the x-shaped frame are ignored: 1",)
    for spheres in (np.vstack([turned[:3], [[70.0, 10.0, 0.0]]]), FOUR):
        with raises(NOT_THE_FRAME, match="PLAN-013"):
            check_plan(plan, make_volume(), fiducials_mm=spheres).require()


def test_an_entry_in_the_outermost_voxels_passes_with_a_warning(plan_text, plan_path, make_volume):
    plan = read_plan(plan_path(plan_text.replace(ENTRY, "entry_mm = [10, -20, 99.9]")))
    result = check_plan(plan, make_volume())
    assert result.passed
    assert any("entry of trajectory T1" in one for one in result.warnings)


def test_an_entry_out_in_the_air_is_warned_about_with_its_distance_from_the_skin(
    plan_text, plan_path, make_volume
):
    farther = plan_text.replace("[10.0, -50.0, 60.0]", "[12.0, -60.0, 76.0]")
    result = check_plan(read_plan(plan_path(farther)), make_volume())
    assert result.passed
    (warning,) = result.warnings
    assert re.match(r"the entry of trajectory T1 is 20 mm in front of the skin", warning), warning


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "margin_mm = 2.0",
            "margin_mm = 20.0",
            "trajectory T2.margin_mm: 20 mm would accept a bad registration; 2.0 is usual",
        ),
        (
            "standoff_mm = 30.0",
            "standoff_mm = 3.0",
            "standoff_mm: 3 mm holds the guide close to the skin; 30 is usual; give millimetres, "
            "not centimetres",
        ),
    ],
)
def test_an_unusual_number_is_warned_about(old, new, said, plan_text, plan_path, make_volume):
    assert said in check_plan(read_plan(plan_path(plan_text.replace(old, new))), make_volume()).warnings


BORE = GuideBore(reach_mm=85.0, length_mm=90.0, play_mm=0.05)


@pytest.mark.hazard(45)
def test_a_stand_off_inside_the_skin_is_refused(plan, make_volume):
    inside = plan.model_copy(update={"standoff_mm": -5.0})
    with pytest.raises(StandoffInsideSkin, match=r"PLAN-018.*standoff_mm of more than 0 mm.*got -5 mm"):
        check_plan(inside, make_volume()).require()


@pytest.mark.hazard(45)
def test_an_entry_on_the_bone_needs_a_stand_off_beyond_the_skin(plan_text, plan_path, make_volume):
    deeper = plan_text.replace("[10.0, -50.0, 60.0]", "[8.0, -38.0, 44.0]")  # 20 mm below the skin
    plan = read_plan(plan_path(deeper)).model_copy(update={"standoff_mm": 15.0})
    found = check_plan(plan, make_volume()).findings
    assert any(isinstance(one, StandoffInsideSkin) for one in found)
    farther = plan.model_copy(update={"standoff_mm": 35.0})
    assert not any(isinstance(one, StandoffInsideSkin) for one in check_plan(farther, make_volume()).findings)


@pytest.mark.hazard(45)
def test_a_depth_stop_beyond_the_instrument_is_refused(plan, make_volume):
    short = plan.model_copy(update={"instrument_length_mm": 160.0})
    one = short.model_copy(update={"trajectories": short.trajectories[:1]})
    assert check_plan(short, make_volume()).passed  # without the guide nobody knows
    with raises(STOP_BEYOND_INSTRUMENT, match=r"PLAN-019: .*limit 160 mm, got 170\.2 mm"):
        check_plan(one, make_volume(), bore=BORE).require()


def test_a_plan_its_strategy_cannot_reach_names_the_strategies_that_can(plan, make_volume, make_arm):
    arm = make_arm(strategy=Stuck(on="T1"))
    result = check_plan(plan, make_volume(), fiducials_mm=FOUR, arm=arm, sight=SIGHT)
    with pytest.raises(NotReachable, match=r"PLAN-007.*T1") as caught:
        result.require()
    assert "T1 by improved or ocs" in caught.value.advice
    assert "T2" not in caught.value.advice


def test_looks_of_ocs_instead_of_chosen_ones_are_a_warning(plan, make_volume, make_arm, monkeypatch):
    arm = make_arm(strategy=find_strategy("learning"))
    assert check_plan(plan, make_volume(), fiducials_mm=FOUR, arm=arm, sight=SIGHT).warnings == ()
    monkeypatch.setattr(learning_looks, "CHOICES", 0)  # as if none were clear
    (warning,) = check_plan(plan, make_volume(), fiducials_mm=FOUR, arm=arm, sight=SIGHT).warnings
    assert warning.startswith("the looks of ocs are used, not chosen ones")


def triangle(first_mm: float, second_mm: float, third_mm: float) -> np.ndarray:
    """Three points with these distances."""
    along = (first_mm**2 + second_mm**2 - third_mm**2) / (2.0 * second_mm)
    return np.array([[0.0, 0, 0], [second_mm, 0, 0], [along, np.sqrt(first_mm**2 - along**2), 0]])


@pytest.mark.parametrize(
    "sides_mm",
    [
        *((90.0, 120.0, 84.1), (90.0, 120.0, 95.9), (90.0, 92.0, 140.0)),
        *((90.0, 120.0, 83.9), (90.0, 120.0, 96.1), (60.0, 100.0, 140.0)),
    ],
)
def test_sides_that_differ_by_less_than_six_millimetres_are_warned_about(sides_mm):
    points = triangle(*sides_mm)
    smallest = np.diff(np.sort(sides_mm)).min()
    assert least_side_difference_mm(points) == pytest.approx(smallest)
    warnings = warn_of_ambiguity(points)
    assert bool(warnings) == (smallest < 6.0)
    assert all(f"differ by {smallest:.1f} mm" in one for one in warnings)


def test_the_warning_about_a_rectangle_names_interchangeable_fiducials():
    rectangle = np.array([[0.0, 0, 0], [80, 0, 0], [80, 110, 0], [0, 110, 0]])
    (warning,) = warn_of_ambiguity(rectangle)
    assert "1 for 2" in warning or "1 for 3" in warning or "1 for 4" in warning


@pytest.mark.parametrize(
    "points_mm",
    [
        [[0, 0, 0], [80, 0, 0], [80, 110, 0], [0, 110, 0], [30, 20, 60]],  # one out of the plane, off centre
        *(np.eye(3)[:count] * 50.0 for count in (0, 1, 2)),
    ],
)
def test_an_unambiguous_layout_and_fewer_than_three_fiducials_give_no_warning(points_mm):
    assert warn_of_ambiguity(np.array(points_mm, dtype=float)) == []


def test_a_plan_with_adhesive_markers_is_refused_with_their_number_and_what_a_case_needs(plan, make_volume):
    adhesive = plan.model_copy(update={"fiducials": FiducialKind.ADHESIVE})
    with raises(MARKERS_ADHESIVE, match=r"PLAN-030.*4 adhesive.*\"free\".*\"adhesive\".*Implant screws"):
        require_spheres(adhesive)
    assert [one.code for one in check_plan(adhesive, make_volume(), fiducials_mm=()).findings] == ["PLAN-030"]
    require_spheres(plan)
