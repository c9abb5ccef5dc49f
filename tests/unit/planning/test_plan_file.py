"""plan.toml: parsed strictly, with all mistakes reported at once."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from bounded_cost import bounded_cost
from coded_errors import raises

from procedures.planning.errors import (
    BAD_TRAJECTORY_GEOMETRY,
    DUPLICATE_TRAJECTORY,
    PLAN_UNREADABLE,
    PlanMistakes,
)
from procedures.planning.plan_file import compose_plan, read_plan
from procedures.planning.plan_model import FiducialKind, PatientPosition
from ronna_hw.errors import EXIT_USAGE


def test_a_plan_is_read(plan_text, plan_path):
    plan = read_plan(plan_path(plan_text))
    assert plan.patient_orientation is PatientPosition.HFS
    assert plan.fiducials is FiducialKind.FREE
    assert plan.implanted == 4
    assert [one.id for one in plan.trajectories] == ["T1", "T2"]
    second = plan.trajectory("T2")
    assert second.entry_mm == (-20.0, -40.0, 70.0)
    assert second.depth_mm == pytest.approx(math.dist((-20, -40, 70), (-15.5, -10, 25)))
    assert second.trajectory.free_angle_rad == pytest.approx(math.radians(30.0))
    with pytest.raises(KeyError):
        plan.trajectory("T3")


@pytest.mark.parametrize(
    "content", ["schema = ", "\x00", "a = " + "[" * 5000, "x = 1\nx = 2", "n = 0\n" * 200_000]
)
def test_a_file_that_is_not_toml_is_unreadable(content, plan_path):
    with raises(PLAN_UNREADABLE, match="PLAN-001") as caught:
        read_plan(plan_path(content))
    assert caught.value.exit_code == EXIT_USAGE
    assert "\n" not in str(caught.value)


def test_a_theatre_file_given_as_a_plan_is_recognised(plan_path):
    with raises(PLAN_UNREADABLE, match="is a theatre file, not a plan"):
        read_plan(plan_path('schema = 1\ntheatre = "lab"\n[tracker]\ndriver = "ndi_polaris"\n'))


def test_a_missing_file_a_folder_and_bytes_that_are_not_text_are_unreadable(tmp_path):
    (tmp_path / "plan.toml").write_bytes(b"\xff\xfe\x00")
    for path in (tmp_path / "absent.toml", tmp_path, tmp_path / "plan.toml"):
        with raises(PLAN_UNREADABLE, match="PLAN-001"):
            read_plan(path)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("schema = 1", "schema = 2", "schema"),
        ("schema = 1\n", "", "schema"),
        ("schema = 1", "schema_version = 1", "schema_version"),
        ('"HFS"', '"supine"', "patient_orientation"),
        ("implanted = 4", "implanted = 2", "implanted"),
        ("implanted = 4", "implanted = 4.0", "implanted"),
        ("implanted = 4", 'implanted = "4"', "implanted"),
        ('"free"', '"glued"', "fiducials"),
        ('tool = "guide"', 'tool = ""', "tool"),
        ('tool = "guide"', 'tool = "guide"\nside = "left"', "side"),
        ('series_instance_uid = "1.2', 'series_instance_uid = "CT 1.2', "series_instance_uid"),
        ("target_mm = [5.0, -20.0, 20.0]", "target_mm = [5.0, -20.0]", "trajectory T1.target_mm"),
        ("target_mm = [5.0, -20.0, 20.0]", "target_mm = [5.0, nan, 20.0]", "trajectory T1.target_mm"),
        ("target_mm = [5.0, -20.0, 20.0]", "target_mm = [5.0, 1e9, 20.0]", "trajectory T1.target_mm"),
        ("margin_mm = 1.5", "", "trajectory T1.margin_mm"),
        ("margin_mm = 1.5", "margin_mm = 0", "trajectory T1.margin_mm"),
        ("margin_mm = 1.5", 'margin_mm = "1.5"', "T1.margin_mm: expected a valid number without quotes"),
        ("margin_mm = 1.5", 'margin_mm = "1,5"', "a valid number, with a decimal point: 1.5 (found '1,5')"),
        ("margin_mm = 1.5", 'margin_mm = "wide"', "T1.margin_mm: expected a valid number (found 'wide')"),
        ('id = "T1"', 'id = "../T1"', ".id: expected letters, digits, _ . or -, a letter or a digit first"),
        ('id = "T1"', 'id = ""', "trajectory 1.id: expected at least 1 character"),
        ('id = "T1"', "", ".id: "),
        ("free_angle_deg = 30.0", "free_angle_deg = inf", "trajectory T2.free_angle_deg"),
        ("free_angle_deg = 30.0", "free_angle = 30.0", "trajectory T2.free_angle"),
    ],
)
def test_each_mistake_is_named_with_its_field(old, new, said, plan_text, plan_path):
    assert old in plan_text
    with pytest.raises(PlanMistakes, match="PLAN-002") as caught:
        read_plan(plan_path(plan_text.replace(old, new, 1)))
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, ValueError)


@pytest.mark.parametrize("trajectories", ["trajectories = []", "trajectories = 3", ""])
def test_a_plan_without_trajectories_is_a_mistake(trajectories, plan_text, plan_path):
    head = plan_text.split("[[trajectories]]")[0]
    with pytest.raises(PlanMistakes, match=r"PLAN-002.*trajectories"):
        read_plan(plan_path(head + trajectories))


FIRST_TARGET = "target_mm = [5.0, -20.0, 20.0]"


@pytest.mark.parametrize(
    ("old", "new", "error", "said"),
    [
        (FIRST_TARGET, "target_mm = [10, -50, 60.2]", BAD_TRAJECTORY_GEOMETRY, "PLAN-004.*T1.*0.2 mm apart"),
        (
            FIRST_TARGET,
            "target_mm = [5, 140, 20]",
            BAD_TRAJECTORY_GEOMETRY,
            r"PLAN-004.*the target at \(5\.0, 140\.0, 20\.0\) mm is .* deep",
        ),
        ('"T2"', '"T1"', DUPLICATE_TRAJECTORY, "PLAN-005.*'T1'"),
        ("standoff_mm = 30.0", "standoff_mm = 0.03", PlanMistakes, "0.03 mm is closer .* not metres"),
        ("implanted = 4", "implanted = 4,0", PLAN_UNREADABLE, "4,0`; decimals have a point, not a comma"),
    ],
)
def test_an_impossible_value_is_refused_with_its_code(old, new, error, said, plan_text, plan_path):
    assert old in plan_text
    with raises(error, match=said):
        read_plan(plan_path(plan_text.replace(old, new, 1)))


def test_all_mistakes_come_in_one_error_with_their_codes(plan_text, plan_path):
    text = plan_text.replace('"T2"', '"T1"').replace("implanted = 4", "implanted = 9")
    text = text.replace("target_mm = [5.0, -20.0, 20.0]", "target_mm = [10, -50, 60]")
    with pytest.raises(PlanMistakes) as caught:
        read_plan(plan_path(text))
    message = str(caught.value)
    for part in ("3 mistakes", "PLAN-002 implanted", "PLAN-004 trajectory T1", "PLAN-005"):
        assert part in message


def test_thousands_of_mistakes_are_counted_not_listed(plan_text, plan_path):
    path = plan_path(plan_text + '[[trajectories]]\nidl = "guide"\n' * 1000)
    with bounded_cost(limit_s=3.0), pytest.raises(PlanMistakes, match=r"and \d{4} more mistakes") as refused:
        read_plan(path)
    assert len(str(refused.value)) < 3000


def test_several_mistakes_of_one_kind_keep_their_code(plan_text, plan_path):
    text = plan_text.replace("target_mm = [5.0, -20.0, 20.0]", "target_mm = [10, -50, 60]")
    text = text.replace("target_mm = [-15.5, -10.0, 25.0]", "target_mm = [-20, -40, 70]")
    with raises(BAD_TRAJECTORY_GEOMETRY, match=r"PLAN-004.*2 mistakes.*trajectory T1.*trajectory T2"):
        read_plan(plan_path(text))


@pytest.mark.parametrize("key", ["instrument_length_mm", "standoff_mm"])
def test_a_plan_of_an_earlier_version_is_refused_with_the_line_to_add(plan_text, plan_path, key):
    older = "\n".join(line for line in plan_text.splitlines() if not line.startswith(key))
    with pytest.raises(PlanMistakes, match=f"PLAN-002: .*{key}.*add `{key} = "):
        read_plan(plan_path(older))


SPHERES_MM = [[1.0, 2.0, 3.0], [40.0, 2.0, 3.0], [1.0, 60.0, 3.0]]
TRAJECTORY = (
    '[[trajectories]]\nid = "T1"\nentry_mm = [0.0, 0.0, 40.0]\ntarget_mm = [0.0, 0.0, 0.0]\nmargin_mm = 2.0\n'
)


def _begun(tmp_path: Path, position: str, spheres_mm: list[list[float]] = SPHERES_MM) -> Path:
    path = tmp_path / "plan.toml"
    path.write_text(compose_plan("1.2.3", position, spheres_mm, "ct"))
    return path


def test_a_new_plan_lacks_only_its_trajectories_and_the_instrument(tmp_path: Path) -> None:
    path = _begun(tmp_path, "HFS")
    with pytest.raises(PlanMistakes, match=r"2 mistakes: instrument_length_mm: .*trajectories: is missing"):
        read_plan(path)
    path.write_text(path.read_text().replace("# instrument_length_mm", "instrument_length_mm") + TRAJECTORY)
    plan = read_plan(path)
    assert (plan.implanted, plan.patient_orientation.value) == (3, "HFS")
    assert "# sphere 3: 1.00, 60.00, 3.00" in path.read_text()


def test_values_missing_from_the_series_are_left_to_the_planner(tmp_path: Path) -> None:
    path = _begun(tmp_path, "", SPHERES_MM[:2])
    path.write_text(path.read_text() + TRAJECTORY)
    with pytest.raises(
        PlanMistakes, match="3 mistakes: patient_orientation: is missing; implanted: is missing; instrument_l"
    ):
        read_plan(path)


FUSED = f"""
[fusion]
series_instance_uid = "1.2.840.5"
modality = "MR"
record_sha256 = "{"a" * 64}"
"""


def test_a_target_chosen_in_another_series_names_the_fusion_and_its_error(plan_text, plan_path):
    chosen = plan_text.replace("margin_mm = 1.5", "margin_mm = 1.5\nfusion_error_mm = 0.4", 1)
    assert chosen != plan_text
    plan = read_plan(plan_path(chosen + FUSED))
    assert [one.fusion_error_mm for one in plan.trajectories] == [0.4, None]
    assert plan.fusion is not None
    assert plan.fusion.modality == "MR"
    with raises(PlanMistakes, match=r"T1: fusion_error_mm needs the table \[fusion\]"):
        read_plan(plan_path(chosen))
    with raises(PlanMistakes, match="needs fusion_error_mm"):
        read_plan(plan_path(plan_text + FUSED))
