"""Export of a run to common formats: plan, spheres, registrations, reached lines and errors.

A run that ended early is exported as far as it came; the index says what is absent and why.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

from procedures.engine.case import Stored, parent_of_kind, results_of
from procedures.exchange import allowed_fields, export_tables
from procedures.exchange.case_results import CaseResults, FindTruth, describe_prediction, read_results
from procedures.exchange.ct_study import CtStudy, read_ct_study
from procedures.exchange.dicom_objects import encode
from procedures.exchange.errors import NOT_WRITABLE
from procedures.exchange.run_objects import Fits, run_objects
from procedures.exchange.sphere_files import document, slicer_markups, table
from procedures.exchange.surface_files import encode_scan_ply, encode_scan_vtp
from procedures.exchange.trajectory_lines import format_lines, tabulate_lines
from procedures.registration.surface.scan import SurfaceScan
from procedures.reporting.run_reading import RunReading, UsedRegistration
from procedures.steps.clinical.results import RegisteredRobot, ScannedSurface
from ronna_hw.evidence.inspection import inspect_run
from ronna_hw.frames import Frame
from ronna_hw.records import write_atomically

ALL = "all"  # name of a registration that serves every trajectory
INDEX = "export.json"
SCAN = "scan of the skin"
WITH_SCAN = "--with-scan"  # the option of the command
FACE = "it shows a face, and so a person"


@dataclass(frozen=True)
class Exported:
    """Files of an export, what the run does not have with the reason, and whose the objects are."""

    files: tuple[Path, ...]
    absent: Mapping[str, str]
    withheld: Mapping[str, str]  # what the run has and this export leaves out, with the reason
    study: CtStudy | None  # patient and study that the DICOM objects name


def export_run(
    run: Path,
    out: Path,
    find_truth: FindTruth = lambda _run: None,
    identity_from: Path | None = None,
    *,
    with_scan: bool = False,
) -> Exported:
    """Write the exportable results of a run to `out`.

    `find_truth` asks the simulated theatre of a run without a stored truth. `identity_from` is the folder of
    the run's CT: its patient and study go into the DICOM objects. `with_scan` adds a scan of the skin, which
    shows a face and so a person. Raises EXC-002, EXC-003, EXC-004, EXC-007,
    EXC-008, REC-003, and PRO-033 before anything is written. EXC-002 also for a folder with files of another
    export.
    """
    results = read_results(RunReading.of(inspect_run(run).require_whole()), find_truth)
    study = (
        None if identity_from is None else read_ct_study(identity_from, results.ct.series, results.ct.study)
    )
    fits = _label_registrations(results)
    texts = {**_case_texts(results), **_registration_texts(fits, results.ct)}
    objects, missing = run_objects(results, fits, () if study is None else study.slice_uids)
    absent = results.absent() | missing
    scan = find_placed_scan(results)
    if scan is None and with_scan:
        absent[SCAN] = _explain_no_scan(results)
    withheld = {} if scan is None or with_scan else {SCAN: f"{FACE}; {WITH_SCAN} adds it"}
    contents = {name: text.encode() for name, text in texts.items()}
    if scan is not None and with_scan:
        contents |= {
            "scan.ply": encode_scan_ply(scan, Frame.CT),
            "scan.vtp": encode_scan_vtp(scan, Frame.CT),
        }
    for name, made in objects.items():
        allowed_fields.require_allowed(made)  # before anybody is named in it
        contents[name] = encode(made if study is None else study.file_object(made))
    index = _index(results, contents, absent, withheld, identified=study is not None)
    contents = {INDEX: index.encode(), **contents}
    _refuse_others(out, set(contents))
    try:
        out.mkdir(parents=True, exist_ok=True)
        for name, content in contents.items():
            write_atomically(out / name, content)
    except OSError as error:
        raise NOT_WRITABLE(f"cannot write into {out}: {error.strerror}") from error
    return Exported(tuple(out / name for name in contents), absent, withheld, study)


def _refuse_others(out: Path, own: set[str]) -> None:
    """Raise EXC-002 if a folder holds files of another export, which would seem to belong to this one."""
    names = {file.name for file in out.glob("*")} - own
    others = sorted(name for name in names if any(fnmatch(name, known) for known in allowed_fields.FILES))
    if others:
        raise NOT_WRITABLE(
            f"{out} holds files that are not of this export",
            expected="a new folder, or an earlier export of this run",
            got=", ".join(others),
        )


def find_placed_scan(results: CaseResults) -> SurfaceScan | None:
    """Return the scan of the skin that the last registration used, placed in the CT by it; None without."""
    by_name = {record.identifier: record for record in results.run.records}
    for used in reversed(results.registrations):
        scanned = parent_of_kind(used.stored.record, ScannedSurface, by_name)
        if scanned is not None:
            (stored,) = results_of(ScannedSurface, [scanned])
            return stored.result.scan.placed(used.result.robot_from_ct.transform.inverse())
    return None


def _explain_no_scan(results: CaseResults) -> str:
    scanned = any(record.kind == ScannedSurface.kind for record in results.run.records)
    return "there is no registration that carries it into the CT" if scanned else "none was made"


def _case_texts(results: CaseResults) -> dict[str, str]:
    """Format what is in the CT: lines, errors and spheres, as far as the run has them."""
    ct, lines, tables = results.ct, results.lines, dict[str, str]()
    texts = {
        f"{kind}.mrk.json": format_lines(lines, ct, kind)
        for kind in (allowed_fields.PLANNED, allowed_fields.REACHED, allowed_fields.FOUND)
        if any(one.kind == kind for one in lines)
    }
    if results.plan is not None:
        tables = {"lines.csv": tabulate_lines(lines, ct), "errors.csv": results.tabulate_errors()}
    if results.spheres is not None and results.spheres.numbered:
        numbered, in_ct_mm = results.spheres.numbered, results.spheres.planning_ct_mm
        plain = {
            number: {
                **allowed_fields.pick_allowed(one.model_dump(mode="json"), allowed_fields.SPHERE_FIELDS),
                "planning_ct_mm": in_ct_mm.get(number),
            }
            for number, one in numbered.items()
        }
        texts |= {"spheres.mrk.json": slicer_markups(numbered, ct), "spheres.json": document(plain, ct)}
        tables["spheres.csv"] = table(numbered, ct, in_ct_mm)
    return texts | _with_schemas(tables)


def _registration_texts(fits: Fits, ct: export_tables.CtIdentity) -> dict[str, str]:
    if not fits:
        return {}
    rows = []
    for fit in fits.values():
        plain = fit.result.model_dump(mode="json")
        shared = allowed_fields.pick_allowed(plain, allowed_fields.REGISTRATION_FIELDS)
        for one in fit.result.predictions:
            row = {"trajectory": one.target, **shared, **describe_prediction(one)}
            row["correction_mm"] = fit.result.correction_mm(one.target)
            rows.append({**row, "record": fit.record.sha256})
    content = {**ct.describe(export_tables.ROBOT_FROM_CT), "registrations": rows}
    text = json.dumps(content, indent=1, allow_nan=False) + "\n"
    return {"registrations.json": text, **_with_schemas({"registrations.csv": _registration_table(fits, ct)})}


def _registration_table(fits: Fits, ct: export_tables.CtIdentity) -> str:
    """Format a CSV with one row per target: the matrix row by row, then the error."""
    elements = [f"m{row}{column}" for row in range(1, 4) for column in range(1, 5)]
    rows = []
    for fit in fits.values():
        shared = {**ct.describe(export_tables.ROBOT_FROM_CT), "pairs": fit.result.pairs}
        shared["fre_mm"] = fit.result.fre_mm
        matrix = fit.result.robot_from_ct.transform.as_matrix()[:3].ravel().tolist()
        pose = dict(zip(elements, matrix, strict=True))
        for one in fit.result.predictions:
            correction = dict(
                zip(allowed_fields.CORRECTION, fit.result.correction_mm(one.target), strict=True)
            )
            row = {"trajectory": one.target, **pose, **correction}
            rows.append({**row, **shared, **describe_prediction(one)})
    return export_tables.format_table("registrations.csv", rows)


def _with_schemas(tables: Mapping[str, str]) -> dict[str, str]:
    return {
        **tables,
        **{name.removesuffix(".csv") + ".schema.csv": export_tables.format_schema(name) for name in tables},
    }


def _label_registrations(results: CaseResults) -> dict[str, Stored[RegisteredRobot]]:
    """Return the registrations by export label, with their targets relabelled too."""
    used, labels = results.registrations, results.labels
    is_single = [one.stored.record.trajectory for one in used].count(None) == 1
    by_label = {}
    for one in used:
        for_all = is_single and one.stored.record.trajectory is None
        label = ALL if for_all else "-".join(labels[name] for name in one.targets)
        by_label[label] = Stored(one.stored.record, _relabel(one, labels))
    return by_label


def _relabel(used: UsedRegistration, labels: Mapping[str, str]) -> RegisteredRobot:
    predictions = tuple(one.model_copy(update={"target": labels[one.target]}) for one in used.predictions)
    changed: dict[str, object] = {"predictions": predictions}
    if (learned := used.result.learned) is not None:
        corrections_mm = {labels[name]: one for name, one in learned.corrections_mm.items() if name in labels}
        changed["learned"] = learned.model_copy(update={"corrections_mm": corrections_mm})
    return used.result.model_copy(update=changed)


def _index(
    results: CaseResults,
    contents: Mapping[str, bytes],
    absent: Mapping[str, str],
    withheld: Mapping[str, str],
    *,
    identified: bool,
) -> str:
    """Format the index: frame, unit and UIDs, files with hashes, what is absent and what is withheld."""
    ending = results.ending
    meanings = {
        name: next(meaning for known, meaning in allowed_fields.FILES.items() if fnmatch(name, known))
        for name in contents
    }
    hashes = {name: hashlib.sha256(content).hexdigest() for name, content in contents.items()}
    ended = {
        "simulated": results.simulated,
        "identified": identified,
        "ending": ending.word,
        "code": ending.code,
    }
    files = {"files": meanings, "sha256": hashes, "absent": dict(absent)}
    files["withheld"] = dict(withheld)
    content = {**results.ct.describe(export_tables.IN_CT), **ended, **files}
    return json.dumps(content, indent=1, allow_nan=False) + "\n"
