"""DICOM objects of a run, all in the study of its CT."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from datetime import datetime

from pydicom.dataset import Dataset

from procedures.engine.case import Stored, ancestor_of_kind
from procedures.exchange import dicom_objects
from procedures.exchange.allowed_fields import name_spheres
from procedures.exchange.case_results import CaseResults
from procedures.exchange.postoperative_objects import (
    REPORT_FILE,
    check_key,
    find_missing_package,
    structured_report,
)
from procedures.exchange.report_page import draw_page, report_page
from procedures.exchange.structure_set import structure_set
from procedures.steps.clinical.cart_lock import LockedCart
from procedures.steps.clinical.results import RegisteredRobot
from ronna_hw.records import Record, canonical_json

SCANNED = "centres of marker spheres by a scan of the clamped head"
UNCORRECTED = "; corrections: registrations.csv"  # that an arm which was learned is given

Fits = Mapping[str, Stored[RegisteredRobot]]  # registrations by their exported label


def run_objects(
    results: CaseResults, fits: Fits, slice_uids: tuple[str, ...] = ()
) -> tuple[dict[str, Dataset], dict[str, str]]:
    """Build the objects by file name, and map what is missing to reasons; `slice_uids` may be unknown."""
    objects, absent = dict[str, Dataset](), dict[str, str]()
    lines = results.lines
    latest = max(datetime.fromisoformat(one.created) for one in results.run.valid_records)
    page = draw_page(results, latest)
    key = hashlib.sha256(page.tobytes()).hexdigest()
    objects["report-page.dcm"] = report_page(page, _origin(results, key, latest))
    if results.spheres is not None:
        spheres = name_spheres(results.spheres.numbered)
        objects |= _registered(results, fits)
        plain = [marker.model_dump(mode="json") for marker in spheres.values()]
        content = [plain, [(one.label, one.kind, *one.entry_mm, *one.end_mm) for one in lines]]
        content.append([latest.isoformat()])  # in it too: one identifier has one content
        origin = _origin(results, hashlib.sha256(canonical_json(content)).hexdigest(), latest)
        objects["structures.dcm"] = structure_set(spheres, lines, origin, slice_uids)
    found = {results.labels[name]: one for name, one in results.found.items() if name in results.labels}
    if results.check is None or not found:
        return objects, absent
    if (missing := find_missing_package()) is not None:
        absent["structured report"] = missing
    else:
        origin = _origin(results, check_key(results.check, found), latest)  # the check has no date
        objects[REPORT_FILE] = structured_report(found, origin)
    return objects, absent


def _registered(results: CaseResults, fits: Fits) -> dict[str, Dataset]:
    """Build the object of the spheres, if any, and one for each registration, which names those it used."""
    assert results.spheres is not None, "the caller has them"
    spheres = results.spheres.numbered
    origin = _record_origin(results, results.spheres.used.record)
    described = (SCANNED,) if results.spheres.are_scanned else ()
    objects = {"spheres.dcm": dicom_objects.sphere_fiducials(spheres, origin, *described)} if spheres else {}
    uids = [dicom_objects.fiducial_uid(origin, name) for name in name_spheres(spheres)]
    for label, fit in fits.items():
        objects[f"registration-{label}.dcm"] = dicom_objects.spatial_registration(
            fit.result.robot_from_ct.transform,
            _record_origin(results, fit.record),
            spheres=origin,
            placing=_placing(fit.record, results),
            description=f"trajectory {label}" + (UNCORRECTED if fit.result.learned else ""),
            fiducial_uids=uids,
        )
    return objects


def _origin(results: CaseResults, key: str, made: datetime) -> dicom_objects.Origin:
    ct = results.ct
    return dicom_objects.Origin(ct.series, ct.frame_of_reference, made, key, ct.study)


def _record_origin(results: CaseResults, record: Record) -> dicom_objects.Origin:
    return _origin(results, record.sha256, datetime.fromisoformat(record.created))


def _placing(registration: Record, results: CaseResults) -> str:
    """Return the hash of the locked-cart record, which identifies the cart position; '' if never locked."""
    by_name = {record.identifier: record for record in results.run.records}
    locked = ancestor_of_kind(registration, LockedCart.kind, by_name)
    return "" if locked is None else locked.sha256
