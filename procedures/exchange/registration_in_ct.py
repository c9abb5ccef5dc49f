"""Registration of a run in its CT: each sphere where the CT has it and where it was found, with a picture."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from procedures.engine.case import results_of
from procedures.exchange.case_spheres import CaseSpheres
from procedures.exchange.run_tables import NOWHERE, sphere_name
from procedures.reporting.run_options import read_options
from procedures.reporting.run_reading import RunReading, UsedRegistration
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.results import Prediction, Relocalization
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Transform
from ronna_hw.loaded_run import RunColumn, RunTable

if TYPE_CHECKING:
    from procedures.imaging.volume import Volume

CASE_FOLDER, CT_FOLDER = "case", "ct"
SPHERES = (
    RunColumn("sphere", str, "its name in `run.spheres`"),
    RunColumn("used", bool, "whether the fit used it"),
    RunColumn(
        "expected_ct_mm",
        float,
        "its centre as the fit used it: by the CT or, after a scan of the clamped head, by that scan",
        (3,),
    ),
    RunColumn("planning_ct_mm", float, "its centre in the planning CT; NaN if it is new since", (3,)),
    RunColumn("found_ct_mm", float, "as the stereo head found it, through the registration", (3,)),
    RunColumn("residual_mm", float, "distance between the two; not the error at a target"),
    RunColumn("without_it_mm", float, "the same, if the fit leaves it out; NaN where that is not known"),
)


@dataclass(frozen=True, repr=False)
class RegistrationInCt:
    """Registration used for a target; `ronna_hw.RunRegistration` describes it."""

    target: str
    record: str
    robot_from_ct: Transform
    sent_robot_from_ct: Transform
    fre_mm: float
    predicted: Prediction
    spheres: RunTable
    series: Path | None  # folder of the CT, if it is here
    series_instance_uid: str

    def __repr__(self) -> str:
        used = int(self.spheres.used.sum())
        return f"{self.record} for {self.target}: {used} spheres, FRE {self.fre_mm:.3f} mm"

    @cached_property
    def picture(self) -> bytes:
        """PNG of the spheres in the CT; black behind them if the CT is not here or is another one."""
        from procedures.imaging.sphere_projection import project_spheres

        table = self.spheres
        return project_spheres(
            self._read_volume(), table.expected_ct_mm, table.found_ct_mm, table.sphere.tolist()
        )

    def _read_volume(self) -> Volume | None:
        from procedures.imaging.series import read_series

        if self.series is None:
            return None
        try:
            volume = read_series(self.series)
        except (RonnaError, OSError):
            return None
        return volume if volume.series_instance_uid == self.series_instance_uid else None

    def _repr_html_(self) -> str:
        """Return picture, residuals and prediction as a notebook shows them."""
        picture = base64.b64encode(self.picture).decode()
        predicted = self.predicted
        return (
            f'<img alt="Spheres of the registration for {escape(self.target)} in the CT" '
            f'src="data:image/png;base64,{picture}">{self.spheres._repr_html_()}'
            f"<p>{escape(self.target)}: FRE {self.fre_mm:.3f} mm, which says that the points fit each other. "
            f"Predicted error at the target {predicted.rms_mm:.3f} mm rms, {predicted.limit_mm:.3f} mm at "
            f"{predicted.confidence:.0%}.</p>"
        )


def registration_in_ct(reading: RunReading, used: UsedRegistration, target: str) -> RegistrationInCt:
    """Build the registration used for a target. Raises REC-001, REC-003."""
    fit, run = used.stored.result, reading.run
    spheres = CaseSpheres.of_registration(used.stored.record, run)
    centres_mm = np.zeros((0, 3)) if spheres is None else spheres.used.result.centres_mm
    shown = () if spheres is None else spheres.used.result.shown
    planning_mm = {} if spheres is None else spheres.planning_ct_mm
    places = np.full((len(centres_mm), 3), np.nan)
    for stored in results_of(Relocalization, run.records):
        if stored.record.identifier in used.stored.record.parents:
            for fiducial, place_mm in fit.found_in_ct_mm(stored.result).items():
                places[fiducial] = place_mm
    left_out = {one.fiducial for one in fit.left_out_spheres}
    without_mm = {row.fiducial: row.leave_one_out_mm for row in fit.two_way.ct_to_room}
    rows = [
        (
            sphere_name(index),
            bool(np.isfinite(place_mm).all()) and index not in left_out,
            centre_mm,
            planning_mm.get(index + 1, NOWHERE),
            place_mm if np.isfinite(place_mm).all() else NOWHERE,
            float(np.linalg.norm(place_mm - centre_mm)),
            np.nan if (apart_mm := without_mm.get(index)) is None else apart_mm,
        )
        for index, centre_mm, place_mm in zip(
            shown, centres_mm[list(shown)], places[list(shown)], strict=True
        )
    ]
    ct = reading.find(ImportedCt)
    return RegistrationInCt(
        target=target,
        record=used.stored.record.identifier,
        robot_from_ct=fit.robot_from_ct.transform,
        sent_robot_from_ct=fit.robot_from_ct_at(target),
        fre_mm=fit.fre_mm,
        predicted=fit.prediction(target),
        spheres=RunTable.of(SPHERES, rows),
        series=_find_series(reading.folder),
        series_instance_uid="" if ct is None else ct.series_instance_uid,
    )


def _find_series(folder: Path) -> Path | None:
    """Return the folder of a run's CT, in it or where its request has the case; None if it is not here."""
    case = read_options(folder).values.get("case")
    series = (Path(str(case)) if case else folder / CASE_FOLDER) / CT_FOLDER
    return series if series.is_dir() else None
