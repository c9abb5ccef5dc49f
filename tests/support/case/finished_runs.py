"""A small finished run to spoil, with all that a run can leave."""

from __future__ import annotations

from pathlib import Path

from plain_steps import Image, plain_order
from recording_cell import RecordingCell

from procedures.engine.case import Case, StepKey
from procedures.engine.context import StepContext
from procedures.engine.order import Outcome
from procedures.engine.run_folder import close_run
from procedures.journal.journal import JOURNAL_FILE, Entry, Journal, read_journal
from procedures.journal.results import StepResult
from procedures.runs.finishing import seal_run
from procedures.runs.interrupted_run import read_interrupted_run
from ronna_hw.evidence.inspection import inspect_run
from ronna_hw.evidence.manifest import LOG_FILES, WORLD_FILE, Manifest, hash_files_at_closing, seal
from ronna_hw.records import Record

REQUEST_HASH = "44136fa355b3678a1146ad16f7e8649e94fb4fc21fe77e8310c060f61caaff8a"  # of {}


def seen(context: StepContext) -> Outcome[StepResult]:
    context.keep_picture("ct-1.png", b"a picture")
    return Outcome(Image())


def finished_run(folder: Path) -> Path:
    """A small run with all that a run can leave: records, pictures, case, log, theatre, report."""
    cell = RecordingCell(folder)
    (folder / "case").mkdir()
    (folder / "case" / "plan.toml").write_text("schema = 1\n")
    (folder / "request.json").write_text("{}")
    cell.journal.write(Entry.OPENED, 0.0, run=folder.name, request_sha256=REQUEST_HASH)
    engine = cell.engine(plain_order("T1", image=seen))
    (folder / "theatre").mkdir()
    (folder / "theatre" / "truth.jsonl").write_text("where the tip was\n")
    engine.run_to()
    engine.close("done")
    for name in (*LOG_FILES, "report.html", WORLD_FILE, "report/targets.csv"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(f"{name}, written after the end\n")
    sealed(folder)
    return folder


def recorded_run(
    run: Path,
    *results: tuple[StepKey, StepResult],
    opened: dict[str, str] | None = None,
    linked: bool = False,
    confirmed: tuple[dict[str, str], ...] = (),
) -> Path:
    """A run folder with these results, in this order, each in place of a former one of its step.

    With `linked` each has all earlier ones as parents. `confirmed` are answers before them.
    """
    run.mkdir(exist_ok=True)
    case, journal = Case(run), Journal(run)
    earlier: list[Record] = []
    if opened is not None:
        journal.write(Entry.OPENED, 0.0, run=run.name, **opened)
    for answer in confirmed:
        journal.write(Entry.CONFIRMATION, 0.0, **answer)
    for key, result in results:
        stored = case.store(key, result, earlier if linked else ())
        earlier.append(stored.record)
        gone = [one.identifier for one in case.records_superseded_by(key)]
        names = {"record": stored.record.identifier, "sha256": stored.record.sha256}
        journal.write(Entry.RESULT, 0.0, step=str(key), supersedes=gone, **names)
        case.accept(key, stored)
    files = hash_files_at_closing(run)
    journal.write(Entry.CLOSED, 0.0, outcome="done", files=files)
    journal.close()
    seal(run, files)
    return run


def sealed(folder: Path) -> None:
    seal(folder, Manifest(tuple(read_journal(folder / JOURNAL_FILE))).files)


def without_last_lines(folder: Path, count: int) -> None:
    journal = folder / JOURNAL_FILE
    journal.write_bytes(b"".join(journal.read_bytes().splitlines(keepends=True)[:-count]))


def changed_files(folder: Path) -> set[str]:
    return {problem.file for problem in inspect_run(folder).changes}


def gone_home(run: Path) -> None:
    """What `home` leaves: the run taken up in spite of the changes, closed and sealed."""
    left = read_interrupted_run(run, only_leaving=True)
    journal = Journal.reopen_run(run, left.run.chain)
    journal.write(Entry.RESTARTED, 0.0, **left.as_plain())
    close_run(run, journal, 0.0, "left", None)
    seal_run(run)
