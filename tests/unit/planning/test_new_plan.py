from pathlib import Path

import pytest

from procedures.planning.errors import PlanMistakes
from procedures.planning.plan_file import new_plan, read_plan

SPHERES_MM = [[1.0, 2.0, 3.0], [40.0, 2.0, 3.0], [1.0, 60.0, 3.0]]
TRAJECTORY = (
    '[[trajectories]]\nid = "T1"\nentry_mm = [0.0, 0.0, 40.0]\ntarget_mm = [0.0, 0.0, 0.0]\nmargin_mm = 2.0\n'
)


def _begun(tmp_path: Path, position: str, spheres_mm: list[list[float]] = SPHERES_MM) -> Path:
    path = tmp_path / "plan.toml"
    path.write_text(new_plan("1.2.3", position, spheres_mm, "ct"))
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
