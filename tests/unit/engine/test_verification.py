"""Any byte that is changed in a finished run, any file that goes or comes, is found."""

import shutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from plain_steps import Image, plain_order
from recording_cell import RecordingCell

from procedures.engine.context import StepContext
from procedures.engine.errors import RunChanged
from procedures.engine.evidence import seal
from procedures.engine.journal import JOURNAL_FILE, read_journal
from procedures.engine.result import StepResult
from procedures.engine.step import Outcome
from procedures.engine.verification import closed_files, problems_of, require_whole


def seen(context: StepContext) -> Outcome[StepResult]:
    context.keep_picture("ct-1.png", b"a picture")
    return Outcome(Image())


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small run with all that a run can leave: records, pictures, case, log, theatre, report."""
    folder = tmp_path_factory.mktemp("finished") / "run"
    cell = RecordingCell(folder)
    (folder / "case").mkdir()
    (folder / "case" / "plan.toml").write_text("schema = 1\n")
    (folder / "request.json").write_text("{}")
    engine = cell.engine(plain_order("T1", image=seen))
    engine.run_to()
    engine.close("done")
    for name in ("log.jsonl", "report.html", "theatre/theatre.toml", "report/targets.csv"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("written after the end\n")
    seal(folder, closed_files(tuple(read_journal(folder / JOURNAL_FILE))))
    return folder


def changed_files(folder: Path) -> set[str]:
    return {problem.file for problem in problems_of(folder)}


def test_a_run_that_was_left_alone_is_whole(finished: Path) -> None:
    assert problems_of(finished) == ()
    require_whole(finished)


@pytest.mark.hazard(39)
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_changed_byte_is_found(finished: Path, data: st.DataObject) -> None:
    files = sorted(path for path in finished.rglob("*") if path.is_file())
    path = data.draw(st.sampled_from(files))
    content = path.read_bytes()
    place = data.draw(st.integers(0, len(content) - 1))
    other = data.draw(st.integers(1, 255)) ^ content[place]
    try:
        path.write_bytes(content[:place] + bytes([other]) + content[place + 1 :])
        assert path.relative_to(finished).as_posix() in changed_files(finished)
        with pytest.raises(RunChanged, match="PRO-033"):
            require_whole(finished)
    finally:
        path.write_bytes(content)


def test_any_file_that_is_gone_is_named(finished: Path, tmp_path: Path) -> None:
    for path in [path for path in finished.rglob("*") if path.is_file()]:
        aside = path.rename(tmp_path / "aside")
        try:
            assert path.relative_to(finished).as_posix() in changed_files(finished)
        finally:
            aside.rename(path)


@pytest.mark.parametrize("name", ["records/08-image.json", "pictures/more.png", "note.txt", "theatre/a/b"])
def test_any_file_that_came_is_named(finished: Path, tmp_path: Path, name: str) -> None:
    run = tmp_path / "run"
    shutil.copytree(finished, run)
    (run / name).parent.mkdir(parents=True, exist_ok=True)
    (run / name).write_text("from elsewhere")
    assert changed_files(run) == {name}


@pytest.mark.hazard(39)
@pytest.mark.parametrize("count", [1, 2, 5])
def test_last_lines_that_are_gone_are_missed(finished: Path, tmp_path: Path, count: int) -> None:
    run = tmp_path / "run"
    shutil.copytree(finished, run)
    journal = run / JOURNAL_FILE
    journal.write_bytes(b"".join(journal.read_bytes().splitlines(keepends=True)[:-count]))
    assert any("not closed" in problem.what for problem in problems_of(run))


def test_a_record_of_another_run_under_its_name_is_named(finished: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(finished, run)
    shutil.copy(run / "records" / "01-image.json", run / "records" / "02-localization-T1.json")
    what = " ".join(problem.what for problem in problems_of(run) if "02-localization" in problem.file)
    assert "not the record that the journal names" in what
    assert "says that it is 01-image" in what


def test_a_run_that_was_killed_is_not_closed(cell: RecordingCell) -> None:
    cell.engine(plain_order("T1")).run_to()
    cell.journal.close()
    assert any("not closed" in problem.what for problem in problems_of(cell.folder))


def test_exports_are_made_at_any_time_and_are_no_part_of_the_run(finished: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(finished, run)
    (run / "export").mkdir()
    (run / "export" / "spheres.csv").write_text("M1")
    assert problems_of(run) == ()
