"""Guard of the inputs: they must not change while results depend on them.

These are CT, scan of the operation, plan and proposed cart position. Asked before every step and motion. An
untouched file is not read again; a touched one is compared by content.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from procedures.engine.case import StepKey
from procedures.engine.engine import Engine
from procedures.engine.setting import ClinicalInput
from procedures.guards.errors import INPUT_CHANGED
from procedures.imaging.series import read_series
from procedures.journal.results import StepResult
from procedures.planning.plan_file import read_plan
from procedures.steps.clinical.cart_lock import LockedCart
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.fiducial_localization import IntraoperativeSpheres
from procedures.steps.clinical.plan_check import CheckedPlan
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.journal_reading import JOURNAL_FILE, JournalValue, read_chain
from ronna_hw.evidence.manifest import Manifest, hash_inputs
from ronna_hw.records import Record

Stamp = tuple[str, int, int, int]  # of a file: name, inode, bytes, time of the last change
Stamps = tuple[Stamp, ...]
SERIES: frozenset[type[StepResult]] = frozenset((ImportedCt, IntraoperativeSpheres))  # folders of slices


class UnchangedInputs:
    """Guard of CT, scan, plan and cart position. Any change ends the step and voids all dependent results."""

    name = "CT, scan, plan and cart position"

    def __init__(self, engine: Engine, clinical: ClinicalInput) -> None:
        """Record the present state of the files. Raises OSError."""
        self._engine = engine
        self._inputs: dict[Path, type[StepResult]] = {
            clinical.series: ImportedCt,
            clinical.scan_series: IntraoperativeSpheres,
            clinical.plan: CheckedPlan,
            clinical.place: LockedCart,
        }
        self._seen = {path: _stamps(path) for path in self._inputs if path.exists()}

    def unmet(self) -> str | None:
        """Describe an unreadable input; None if all can be read. Raises PRO-021 for a changed one."""
        for path, model in self._inputs.items():
            stored = self._engine.case.find(model, None)
            if model is IntraoperativeSpheres and (stored is None or self._is_running(model)):
                continue  # if at all, it is made during the operation, and again when the step is repeated
            try:
                if stored is None:  # nothing depends on its content yet, and each slice read asks here
                    path.stat()
                    continue
                stamps = _stamps(path)
            except OSError as error:
                if model is LockedCart and (stored is None or not _has_proposal(stored.result)):
                    continue  # it need not be there
                return f"{path.name} cannot be read ({error.strerror}): restore it"
            if stamps == self._seen.get(path):
                continue
            key = StepKey(model.kind)
            if model is LockedCart and not _has_proposal(stored.result):
                self._engine.find(f"{path.name} did not exist at {key}: the cart is not compared with it")
            elif changed := _describe_change(stored.result, path):
                problem = INPUT_CHANGED(f"{path.name} has changed since {key}: {changed}")
                self._engine.context(key).void(model, problem)
                self._seen[path] = stamps
                raise problem
            elif model not in SERIES:
                note_same_content(self._engine, path, stored.record)
            self._seen[path] = stamps
        return None

    def _is_running(self, model: type[StepResult]) -> bool:
        """Return whether the step that leaves this result is running."""
        return self._engine.running is not None and self._engine.running.name == model.kind

    def close(self) -> None:
        """Record inputs that were rewritten with the same content by the end of the run."""
        for path, model in self._inputs.items():
            stored = self._engine.case.find(model, None)
            if stored is None or model in SERIES or not path.exists():
                continue
            if not _describe_change(stored.result, path):
                with suppress(RonnaError):  # the journal cannot be written: close all the same
                    note_same_content(self._engine, path, stored.record)


def note_same_content(engine: Engine, path: Path, record: Record) -> None:
    """Record that a plan or position was rewritten unchanged: its result stays valid. Raises PRO-003."""
    folder = engine.case.folder
    then = Manifest(read_chain(folder / JOURNAL_FILE).lines).result_inputs
    now: dict[str, JournalValue] = dict(hash_inputs(folder, [path]))
    if any(then.get(name, sha256) != sha256 for name, sha256 in now.items()):
        text = f"{path.name} was written again with the same content"
        engine.find(text, record=record.identifier, inputs=now)


def _has_proposal(result: StepResult) -> bool:
    return isinstance(result, LockedCart) and result.proposal is not None


def _describe_change(result: StepResult, path: Path) -> str:
    """Describe how an input differs, or why it cannot be read; empty if unchanged."""
    try:
        if isinstance(result, ImportedCt):
            return result.differences(read_series(path))
        if isinstance(result, IntraoperativeSpheres):
            return result.file_differences(path)
        if isinstance(result, LockedCart):
            return result.differences(path)
        same = isinstance(result, CheckedPlan) and read_plan(path) == result.plan
        return "" if same else "another plan"
    except (RonnaError, OSError) as problem:
        return str(problem)


def _stamps(path: Path) -> Stamps:
    if not path.is_dir():
        return (_stamp(path),)
    with os.scandir(path) as files:  # a series has hundreds of slices, and this is asked before each motion
        return tuple(sorted(map(_stamp, files)))


def _stamp(file: Path | os.DirEntry[str]) -> Stamp:
    seen = file.stat()
    return file.name, seen.st_ino, seen.st_size, seen.st_mtime_ns
