"""Structures that a plan avoids: read, thinned, measured and judged."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from coded_errors import raises

from procedures.imaging.volume import Volume
from procedures.planning.errors import NEAR_STRUCTURE, OUTSIDE_FIELD, STRUCTURE_UNREADABLE, PlanMistakes
from procedures.planning.plan_check import check_plan
from procedures.planning.plan_file import parse_plan, read_plan, write_plan
from procedures.planning.plan_model import MOST_POINTS, Plan, Structure
from procedures.planning.structures import build_structure, measure_distances, read_structure
from ronna_hw.errors import RonnaError

BESIDE_TARGET = (9.0, -20.0, 20.0)  # 4 mm to the left of the target of T1


@pytest.fixture
def plan(plan_text: str, plan_path: Callable[[str], Path]) -> Plan:
    return read_plan(plan_path(plan_text))


def avoiding(plan: Plan, *structures: Structure) -> Plan:
    content = plan.model_dump(mode="json", by_alias=True, exclude_none=True)
    return parse_plan({**content, "structures": [one.model_dump(mode="json") for one in structures]})


def test_the_distance_is_measured_to_the_axis_between_entry_and_target(plan: Plan) -> None:
    entry, target = np.array(plan.trajectories[0].entry_mm), np.array(plan.trajectories[0].target_mm)
    along = (target - entry) / np.linalg.norm(target - entry)
    across = np.cross(along, (1.0, 0.0, 0.0))
    across /= np.linalg.norm(across)
    beside = (entry + target) / 2.0 + 7.0 * across
    beyond = target + 5.0 * along
    for place, distance_mm in ((beside, 7.0), (beyond, 5.0), (entry, 0.0)):
        one = Structure(name="vessel", margin_mm=3.0, points_mm=(tuple(place.tolist()),))
        first, _ = measure_distances(avoiding(plan, one))
        assert first.distance_mm == pytest.approx(distance_mm)
        assert first.is_kept == (distance_mm >= 3.0)


@pytest.mark.parametrize(("margin_mm", "passes"), [(3.5, True), (4.5, False)])
def test_a_trajectory_within_the_margin_of_a_structure_is_refused(
    plan: Plan, make_volume: Callable[..., Volume], margin_mm: float, passes: bool
) -> None:
    near = build_structure("vessel", margin_mm, [BESIDE_TARGET])
    check = check_plan(avoiding(plan, near), make_volume())
    assert check.passed == passes
    said = check.as_payload()["structures"][0]
    assert (said["name"], said["trajectory"], said["margin_mm"]) == ("vessel", "T1", margin_mm)
    if not passes:
        with raises(NEAR_STRUCTURE, match=r"PLAN-027.*T1.*vessel.*at least 4\.5 mm.*got 4\.0 mm"):
            check.require()


def test_a_structure_outside_the_ct_field_is_refused(plan: Plan, make_volume: Callable[..., Volume]) -> None:
    elsewhere = build_structure("vessel", 1.0, [(90.0, 90.0, 98.0), (90.0, 90.0, 101.0), (90.0, 90.0, 104.0)])
    with raises(OUTSIDE_FIELD, match=r"PLAN-006.*67% of the points of vessel"):
        check_plan(avoiding(plan, elsewhere), make_volume()).require()


def test_gaps_wider_than_the_margin_are_warned_about(plan: Plan, make_volume: Callable[..., Volume]) -> None:
    sparse = build_structure("vessel", 1.0, [(60.0, 0.0, 0.0), (60.0, 20.0, 0.0)])
    (warning,) = check_plan(avoiding(plan, sparse), make_volume()).warnings
    assert "vessel are up to 20.0 mm apart" in warning


def test_the_gap_between_slices_is_subtracted_where_the_points_of_each_lie_close(plan: Plan) -> None:
    way = plan.trajectories[0]
    middle = (np.array(way.entry_mm) + way.target_mm) / 2.0
    turns = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    ring = 6.0 * np.stack([np.cos(turns), np.sin(turns), np.zeros(40)], axis=1)
    rings = np.concatenate([middle + ring + (0.0, 0.0, up) for up in (-15.0, -5.0, 5.0, 15.0)])
    along = np.subtract(way.target_mm, way.entry_mm) / way.depth_mm
    across = np.cross(along, (1.0, 0.0, 0.0))
    across /= np.linalg.norm(across)
    line = [middle + 1.3 * across + step * np.array((1.0, 0.0, 0.0)) for step in (-8.25, -2.75, 2.75, 8.25)]
    for points in (rings, line):
        first, _ = measure_distances(avoiding(plan, build_structure("vessel", 3.0, points)))
        assert not first.is_kept


def test_a_thinned_structure_never_seems_farther_away_than_it_is(plan: Plan) -> None:
    cloud = np.random.default_rng(5).uniform((-35.0, -60.0, 50.0), (45.0, 20.0, 130.0), (20_000, 3))
    thin = build_structure("vessel", 1.0, cloud)
    assert len(thin.points_mm) <= MOST_POINTS
    within = avoiding(plan, thin)
    for said in measure_distances(within):
        way = plan.trajectory(said.trajectory)
        samples = np.linspace(way.entry_mm, way.target_mm, 200)
        nearest = min(float(np.linalg.norm(cloud - one, axis=1).min()) for one in samples)
        assert said.distance_mm <= nearest + 0.1


def test_a_plan_with_structures_survives_writing_and_reading(plan: Plan, tmp_path: Path) -> None:
    full = [
        build_structure(f"S{k}", 2.0, np.random.default_rng(k).uniform(-99.0, 99.0, (1000, 3)))
        for k in range(3)
    ]
    file = tmp_path / "plan.toml"
    write_plan(file, avoiding(plan, *full))
    assert read_plan(file).structures == tuple(full)


def test_duplicate_structure_names_and_too_many_points_are_refused(plan: Plan) -> None:
    one = build_structure("vessel", 2.0, [(0.0, 0.0, 0.0)])
    with pytest.raises(PlanMistakes, match=r"PLAN-002.*the same name"):
        avoiding(plan, one, one)
    clouds = [build_structure(f"S{k}", 2.0, np.arange(3000.0).reshape(-1, 3)) for k in range(4)]
    with pytest.raises(PlanMistakes, match=r"PLAN-002.*4000 points in total, limit 3000"):
        avoiding(plan, *clouds)


def test_points_are_imported_from_csv_and_slicer_files(make_volume: Callable[..., Volume]) -> None:
    geometry = make_volume().geometry
    rows = b"L_mm,P_mm,S_mm\n1,2,3\n-4,5.5,6\n"
    slicer = (
        b'{"markups": [{"coordinateSystem": "RAS", "controlPoints": [{"position": [-1, -2, 3]},'
        b' {"position": [4, -5.5, 6]}]}]}'
    )
    for content, name in ((rows, "a.csv"), (slicer, "a.mrk.json")):
        read = read_structure(content, name, "vessel", 3.0, geometry)
        assert set(read.points_mm) == {(1.0, 2.0, 3.0), (-4.0, 5.5, 6.0)}


@pytest.mark.parametrize(
    ("content", "error", "said"),
    [
        *(
            (content, STRUCTURE_UNREADABLE, "PLAN-028.*Give CSV rows")
            for content in (b"", b"\xff\xfe", b"1,2\n", b"x,y,z\n1,2,3\n", b"1,2,nan\n")
        ),
        (
            b"0.009,-0.02,0.02\n0.01,-0.03,0.03\n",
            STRUCTURE_UNREADABLE,
            r"PLAN-028.*vessel\.csv.*millimetres, not metres",
        ),
        (b"0,0,900\n", OUTSIDE_FIELD, r"PLAN-006.*100% of the points in vessel\.csv"),
    ],
)
def test_a_file_without_points_in_millimetres_of_this_ct_is_refused(
    content: bytes, error: type[RonnaError], said: str, make_volume: Callable[..., Volume]
) -> None:
    with raises(error, match=said):
        read_structure(content, "vessel.csv", "vessel", 3.0, make_volume().geometry)
