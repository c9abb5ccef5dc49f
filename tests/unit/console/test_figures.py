"""What had been measured at a moment of a recorded case: nothing of what came later."""

from __future__ import annotations

from console.feed.view import CaseView, StepRow
from console.figures import as_of
from procedures.operator.evidence import Evidence
from procedures.reporting.case_figures import CaseFigures, PredictionFigure, SphereFigure, TrajectoryFigure

PLACE = (1.0, 2.0, 3.0)
FIGURES = CaseFigures(
    spheres=(SphereFigure(1, PLACE, PLACE, PLACE),),
    trajectories=(TrajectoryFigure("T1", PLACE, PLACE),),
    predictions=(PredictionFigure("T1", 0.2, 0.4, 0.95, 2.0), PredictionFigure("T2", 0.2, 0.4, 0.95, 2.0)),
    tables=(Evidence(title="budget", head=("source",), rows=()),),
    pictures=("stereo-T1-1.png",),
)


def after(*done: str) -> CaseFigures:
    view = CaseView(steps=tuple(StepRow(one, one, "", False, "done") for one in done))
    found = as_of(FIGURES, view, view)
    assert found is not None
    return found


def test_instruments_appear_one_after_the_other() -> None:
    assert as_of(None, CaseView(), CaseView()) is None
    nothing = after("ct_import")
    tracked = after("global_localization")
    matched = after("global_localization", "correspondence")
    localized = after("global_localization", "correspondence", "relocalization:T1")
    assert nothing.spheres == (SphereFigure(1, None, None, None),)
    assert tracked.spheres == (SphereFigure(1, None, PLACE, None),)
    assert (matched.spheres[0].ct_mm, matched.trajectories, matched.pictures) == (
        PLACE,
        FIGURES.trajectories,
        (),
    )
    assert (localized.spheres, localized.pictures) == (FIGURES.spheres, FIGURES.pictures)


def test_a_prediction_appears_with_the_registration_that_is_for_its_target() -> None:
    first, every = after("registration:T1"), after("registration")
    assert [one.target for one in first.predictions] == ["T1"]
    assert every.predictions == FIGURES.predictions


def test_figures_of_a_result_that_was_repeated_since_are_not_shown_before_that() -> None:
    then, now = (
        CaseView(steps=(StepRow("registration", "", "", False, "done", record=record),))
        for record in ("registration-1", "registration-2")
    )
    shown = [as_of(FIGURES, view, now) for view in (then, now)]
    assert [bool(one and one.predictions) for one in shown] == [False, True]
