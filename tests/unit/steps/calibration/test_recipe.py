"""What a calibration only starts from may have expired; what it relies on may not."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from clinical_case import ClinicalCell

from procedures.engine.engine import Engine
from procedures.engine.errors import NotRecorded
from procedures.engine.order import order_of
from procedures.steps.calibration.recipe import Calibrated, Recipe
from procedures.steps.clinical import set_up
from procedures.steps.clinical.set_up import CheckedSetUp
from ronna_hw.calibration import CalibrationExpired

LAST_MONTH = datetime.now(UTC) - timedelta(days=31)


def set_up_with_expired(folder: Path, name: str, of: Calibrated) -> CheckedSetUp:
    return set_up_with(folder, name, of, created=LAST_MONTH - timedelta(days=30), expires=LAST_MONTH)


def set_up_with(folder: Path, name: str, of: Calibrated, **dates: datetime) -> CheckedSetUp:
    cell = ClinicalCell(folder)
    record = cell.calibrations.records[name].model_copy(update=dates)
    cell.workcell = cell.make_workcell(cell.calibrations.model_copy(update={name: record}))
    setting = replace(cell.setting(), starts=Recipe(of=of, looks=1, more=1).starts)
    engine = Engine(order_of([set_up.STEP], ()), cell.case, setting, cell.journal)
    engine.run_to()
    return cell.case.get(CheckedSetUp).result


@pytest.mark.hazard(26)
@pytest.mark.parametrize(
    ("of", "name"),
    [
        (Calibrated.HEAD, "tool_tip"),
        (Calibrated.HEAD, "stereo_head"),
        (Calibrated.FRAME, "tracker_frame"),
        (Calibrated.TIP, "tool_tip"),
    ],
)
def test_a_calibration_may_start_from_an_expired_record_whose_dates_stay_in_the_set_up(
    tmp_path: Path, of: Calibrated, name: str
) -> None:
    done = set_up_with_expired(tmp_path, name, of)
    assert done.calibrations.records[name].expires == LAST_MONTH


@pytest.mark.hazard(29)
def test_a_calibration_does_not_start_from_a_record_dated_in_the_future(tmp_path: Path) -> None:
    with pytest.raises(CalibrationExpired, match="in the future"):
        set_up_with(tmp_path, "tool_tip", Calibrated.HEAD, created=datetime.now(UTC) + timedelta(days=400))


@pytest.mark.hazard(26)
@pytest.mark.parametrize("of", [Calibrated.ARM, Calibrated.FRAME, Calibrated.TIP])
def test_a_calibration_that_relies_on_an_expired_head_is_refused(tmp_path: Path, of: Calibrated) -> None:
    with pytest.raises(CalibrationExpired, match=r"CAL-001.*stereo"):
        set_up_with_expired(tmp_path, "stereo_head", of)


def test_a_recipe_of_a_billion_looks_is_refused() -> None:
    with pytest.raises(NotRecorded, match=r"PRO-024: this version does not know.*looks"):
        Recipe.read({"of": "arm", "looks": 10**9, "more": 0})
