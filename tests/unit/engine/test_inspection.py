"""Whatever is changed in a run, byte or file, is found and named, and told from what a kill may leave."""

import json
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from plain_steps import Image, plain_order
from recording_cell import RecordingCell
from spoilt_runs import files_in, with_another_byte

from procedures.cli.case.leaving_report import seal_run
from procedures.engine.closing import close_run
from procedures.engine.context import StepContext
from procedures.engine.left_run import read_left_run
from procedures.engine.step import Outcome
from procedures.journal.journal import JOURNAL_FILE, Entry, Journal, read_journal
from procedures.results.result import StepResult
from ronna_hw.evidence.errors import RunChanged
from ronna_hw.evidence.inspection import Problem, closed_files, inspected
from ronna_hw.evidence.journal_reading import read_chain
from ronna_hw.evidence.seal import LARGEST_FILE_BYTES, SEAL_FILE, is_sealed, read_seal, seal
from ronna_hw.evidence.truth_so_far import truth_so_far
from ronna_hw.records import read_record, write_record

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
    for name in ("log.jsonl", "report.html", "theatre/world.json", "report/targets.csv"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(f"{name}, written after the end\n")
    sealed(folder)
    return folder


def sealed(folder: Path) -> None:
    seal(folder, closed_files(tuple(read_journal(folder / JOURNAL_FILE))))


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return finished_run(tmp_path_factory.mktemp("finished") / "run")


@pytest.fixture
def run(finished: Path, tmp_path: Path) -> Path:
    """A copy to spoil."""
    return shutil.copytree(finished, tmp_path / finished.name)


@pytest.fixture
def killed(run: Path) -> Path:
    """The same run, killed before it was closed."""
    (run / SEAL_FILE).unlink()
    without_last_lines(run, 1)
    return run


def without_last_lines(folder: Path, count: int) -> None:
    journal = folder / JOURNAL_FILE
    journal.write_bytes(b"".join(journal.read_bytes().splitlines(keepends=True)[:-count]))


def changed_files(folder: Path) -> set[str]:
    return {problem.file for problem in inspected(folder).changes}


def test_a_run_that_was_left_alone_is_whole(finished: Path) -> None:
    assert inspected(finished).require_whole().problems == ()


@pytest.mark.hazard(39)
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_changed_byte_is_found(finished: Path, data: st.DataObject) -> None:
    path = data.draw(st.sampled_from(files_in(finished)))
    place = data.draw(st.integers(0, path.stat().st_size - 1))
    with with_another_byte(path, place, data.draw(st.integers(1, 255))):
        assert path.relative_to(finished).as_posix() in {one.file for one in inspected(finished).problems}
        with pytest.raises(RunChanged, match="PRO-033"):
            inspected(finished).require_whole()


@pytest.mark.hazard(39)
def test_any_file_that_is_gone_is_named(finished: Path, tmp_path: Path) -> None:
    for path in files_in(finished):
        aside = path.rename(tmp_path / "aside")
        try:
            named = {problem.file for problem in inspected(finished).problems}
            assert path.relative_to(finished).as_posix() in named
        finally:
            aside.rename(path)


@pytest.mark.hazard(39)
def test_any_two_files_that_were_exchanged_are_named(run: Path) -> None:
    for one, other in combinations(files_in(run), 2):
        contents = one.read_bytes(), other.read_bytes()
        one.write_bytes(contents[1])
        other.write_bytes(contents[0])
        named = {problem.file for problem in inspected(run).problems}
        exchanged = {path.relative_to(run).as_posix() for path in (one, other)}
        # Without journal and seal nothing can be said of the rest.
        assert (exchanged & {JOURNAL_FILE} or exchanged & {SEAL_FILE} or exchanged) <= named
        one.write_bytes(contents[0])
        other.write_bytes(contents[1])


@pytest.mark.parametrize("name", ["records/08-image.json", "pictures/more.png", "note.txt", "theatre/a/b"])
def test_any_file_that_came_is_named(run: Path, name: str) -> None:
    (run / name).parent.mkdir(parents=True, exist_ok=True)
    (run / name).write_text("from elsewhere")
    assert changed_files(run) == {name}


@pytest.fixture
def chain_of_folders() -> Iterator[Callable[[Path], None]]:
    """Makes folders nested deeper than the interpreter has frames."""
    made: list[Path] = []

    def make(folder: Path) -> None:
        made.append(folder)
        folder.mkdir()
        at = os.open(folder, os.O_RDONLY)
        for _ in range(1200):
            os.mkdir("d", dir_fd=at)
            inner = os.open("d", os.O_RDONLY, dir_fd=at)
            os.close(at)
            at = inner
        os.close(at)

    yield make
    subprocess.run(["rm", "-rf", *made], check=True)  # pytest removes its folders by recursion


@pytest.mark.parametrize("where", ["", "report/", "theatre/"])
def test_a_chain_of_folders_without_end_is_an_added_one(
    run: Path, where: str, chain_of_folders: Callable[[Path], None]
) -> None:
    chain_of_folders(run / f"{where}deep")
    (problem,) = inspected(run).changes
    assert problem.file.startswith(f"{where}deep/")
    assert problem.beside
    gone_home(run)
    assert inspected(run).problems == (problem,)


@pytest.mark.parametrize("where", ["export", ".report.partial"])
def test_a_chain_of_folders_outside_the_run_is_not_looked_at(
    run: Path, where: str, chain_of_folders: Callable[[Path], None]
) -> None:
    chain_of_folders(run / where)
    assert inspected(run).problems == ()


@pytest.mark.parametrize("size", [LARGEST_FILE_BYTES + 1, 300_000_000_000])
def test_a_file_without_end_is_changed_by_its_size_alone(run: Path, size: int) -> None:
    os.truncate(run / "pictures" / "ct-1.png", size)
    (problem,) = inspected(run).problems
    assert str(problem) == "pictures/ct-1.png: changed: larger than any file of a run"


def test_a_name_that_is_no_text_never_comes_into_the_seal(run: Path) -> None:
    (run / SEAL_FILE).unlink()
    (run / "report" / os.fsdecode(b"a\xff")).write_text("from elsewhere")
    seal_run(run)
    assert [str(problem) for problem in inspected(run).problems] == [
        "report/a\\udcff: added: not part of the run"
    ]


def test_a_file_whose_name_has_a_line_break_forges_no_line(run: Path) -> None:
    (run / "note\nwhole.json").write_text("from elsewhere")
    assert [str(problem) for problem in inspected(run).problems] == [
        "note whole.json: added: not part of the run"
    ]


@pytest.mark.hazard(39)
@pytest.mark.parametrize("count", [1, 2, 5])
def test_last_lines_that_are_gone_are_missed_by_the_seal(run: Path, count: int) -> None:
    without_last_lines(run, count)
    assert JOURNAL_FILE in changed_files(run)


@pytest.mark.hazard(39)
def test_a_record_of_another_run_is_named(run: Path, tmp_path: Path) -> None:
    name = "records/02-localization-T1.json"
    shutil.copy(finished_run(tmp_path / "another") / name, run / name)
    what = " ".join(problem.what for problem in inspected(run).changes if problem.file == name)
    assert "not the record named in the journal" in what
    assert "is of run another" in what


def other_date(folder: Path) -> None:
    path = folder / "records" / "02-localization-T1.json"
    record = read_record(path)
    path.unlink()
    write_record(replace(record, created="2020-01-01T00:00:00.000+00:00"), path.parent)


def exchanged_identifiers(folder: Path) -> None:
    path = folder / "records" / "02-localization-T1.json"
    path.write_text(path.read_text().replace("02-localization", "03-localization"))


def other_request(folder: Path) -> None:
    (folder / "request.json").write_text('{"seed": 4}')


def other_picture(folder: Path) -> None:
    (folder / "pictures" / "ct-1.png").write_bytes(b"of somebody else")


def link_to_the_same(folder: Path) -> None:
    path = folder / "pictures" / "ct-1.png"
    path.rename(folder.parent / "elsewhere.png")
    path.symlink_to(folder.parent / "elsewhere.png")


def pipe(folder: Path) -> None:
    path = folder / "pictures" / "ct-1.png"
    path.unlink()
    os.mkfifo(path)


SPOILED = {
    other_date: "records/02-localization-T1.json",
    exchanged_identifiers: "records/02-localization-T1.json",
    other_request: "request.json",
    other_picture: "pictures/ct-1.png",
    link_to_the_same: "pictures/ct-1.png",
    pipe: "pictures/ct-1.png",
}


@pytest.mark.hazard(39)
@pytest.mark.parametrize("spoil", SPOILED, ids=lambda spoil: spoil.__name__)
def test_what_was_changed_after_a_kill_is_told_from_the_kill(
    killed: Path, spoil: Callable[[Path], None]
) -> None:
    assert changed_files(killed) == set()
    assert [problem.what.partition(":")[0] for problem in inspected(killed).problems] == ["not closed"]
    spoil(killed)
    assert changed_files(killed) == {SPOILED[spoil]}


@pytest.mark.hazard(39)
def test_the_truth_is_held_from_the_moment_the_run_is_closed(run: Path) -> None:
    (run / SEAL_FILE).unlink()
    assert changed_files(run) == set()
    (run / "theatre" / "truth.jsonl").write_text("elsewhere\n")
    (run / "records" / "99-image.json").write_text("{}")
    assert changed_files(run) == {"theatre/truth.jsonl", "records/99-image.json"}


@pytest.fixture
def sampled(tmp_path: Path) -> Path:
    """A run that was killed after a sample of the truth had been taken, and a result was written."""
    folder = tmp_path / "run"
    (folder / "theatre").mkdir(parents=True)
    scene, truth = (folder / "theatre" / name for name in ("scene.json", "truth.jsonl"))
    scene.write_text("where everything is\n")
    journal = Journal(folder)
    journal.write(Entry.OPENED, 0.0, run=folder.name, **truth_so_far(folder))
    journal.write(Entry.INTENT, 1.0, step="at_target:T1")
    truth.write_text("where the tip was\n")
    assert changed_files(folder) == set()  # killed at its target
    journal.write(Entry.FOUND, 2.0, **truth_so_far(folder))
    journal.close()
    assert changed_files(folder) == set()
    return folder


@pytest.mark.hazard(39)
@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("scene.json", "where nothing is\n"),
        ("truth.jsonl", "where the tip was not\n"),
        ("truth.jsonl", ""),
        ("truth.jsonl", None),
        ("truth.jsonl", "where the tip was\nand where it is wanted\n"),
    ],
    ids=["scene", "sample", "emptied", "gone", "added"],
)
def test_truth_that_is_exchanged_in_a_run_that_was_killed_is_named(
    sampled: Path, name: str, content: str | None
) -> None:
    path = sampled / "theatre" / name
    path.unlink()
    if content is not None:
        path.write_text(content)
    assert changed_files(sampled) == {f"theatre/{name}"}


def test_truth_of_any_length_in_the_journal_costs_no_memory(sampled: Path) -> None:
    journal = Journal.taken_up(sampled, read_chain(sampled / JOURNAL_FILE))
    journal.write(Entry.FOUND, 3.0, truth={"theatre/truth.jsonl": [10**18, "0"]})
    journal.close()
    assert changed_files(sampled) == {"theatre/truth.jsonl"}


@pytest.mark.hazard(39)
def test_a_run_that_was_taken_up_again_is_held_against_its_first_end(run: Path) -> None:
    journal = Journal.taken_up(run, read_chain(run / JOURNAL_FILE))
    journal.write(Entry.RESTARTED, 1.0)
    journal.close()
    (run / "log.jsonl").write_text("goes on\n")
    assert changed_files(run) == set()
    (run / "case" / "plan.toml").write_text("another")
    assert changed_files(run) == {"case/plan.toml"}


def test_a_seal_of_an_earlier_end_does_not_make_a_run_whole(run: Path) -> None:
    files = closed_files(tuple(read_journal(run / JOURNAL_FILE)))
    journal = Journal.taken_up(run, read_chain(run / JOURNAL_FILE))
    journal.write(Entry.RESTARTED, 1.0)
    journal.write(Entry.CLOSED, 2.0, outcome="done", files=files)
    journal.close()
    assert not is_sealed(run)
    assert [problem.file for problem in inspected(run).problems] == [SEAL_FILE]
    with pytest.raises(RunChanged, match="the last end was not sealed"):
        inspected(run).require_whole()
    sealed(run)
    assert inspected(run).problems == ()


def test_a_seal_of_a_journal_of_any_length_costs_no_memory(run: Path) -> None:
    made = read_seal(run)
    assert made is not None
    longer = made.model_copy(update={"journal_bytes": 10**18}).signed()
    (run / SEAL_FILE).write_text(longer.model_dump_json(by_alias=True, indent=1))
    assert inspected(run).changes == ()  # of the same bytes, which are all there is
    (run / JOURNAL_FILE).write_bytes((run / JOURNAL_FILE).read_bytes() + b"\n")
    assert changed_files(run) == {JOURNAL_FILE}


def test_nobody_adds_a_line_to_a_sealed_run(run: Path) -> None:
    journal = Journal.taken_up(run, read_chain(run / JOURNAL_FILE))
    journal.write(Entry.FINDING, 1.0, text="all is well")
    journal.close()
    assert changed_files(run) == {JOURNAL_FILE}


def test_a_line_of_endless_brackets_is_found_like_any_other(run: Path) -> None:
    with (run / JOURNAL_FILE).open("ab") as journal:
        journal.write(b"[" * 100_000 + b"\n")
    assert changed_files(run) == {JOURNAL_FILE}


@pytest.mark.parametrize("name", ["9" * 300, "a\0b"], ids=["too long", "with a zero byte"])
def test_a_journal_may_name_files_that_no_disk_can_hold(tmp_path: Path, name: str) -> None:
    cell = RecordingCell(tmp_path / "run")
    cell.journal.write(Entry.RESULT, 0.0, step="image", record=name, sha256="0", pictures={name: "0"})
    cell.journal.write(Entry.CLOSED, 0.0, files={name: "0"})
    wrong = {problem.file for problem in inspected(cell.folder).changes}
    assert wrong >= {f"records/{name}.json", f"pictures/{name}", name}


def test_a_repeated_step_leaves_the_pictures_of_the_first(cell: RecordingCell) -> None:
    order = plain_order("T1", image=seen)
    engine = cell.engine(order)
    for _ in range(3):
        engine.run_step(order.find("image"))
    engine.close("left")
    assert sorted(os.listdir(cell.folder / "pictures")) == ["ct-1-2.png", "ct-1-3.png", "ct-1.png"]
    assert inspected(cell.folder).changes == ()


@pytest.mark.hazard(39)
def test_a_run_under_another_name_is_not_that_run(run: Path) -> None:
    assert {json.loads(path.read_text())["run"] for path in (run / "records").iterdir()} == {"run"}
    renamed = run.rename(run.with_name("another"))
    with pytest.raises(RunChanged, match="of run run, in a folder named another"):
        inspected(renamed).require_whole()


def renamed(run: Path) -> Path:
    return run.rename(run.with_name("another"))


def with_a_stray_file(run: Path) -> Path:
    (run / "notes.txt").write_text("mine")
    return run


def with_a_changed_picture(run: Path) -> Path:
    next((run / "pictures").iterdir()).write_bytes(b"another")
    return run


@pytest.mark.parametrize("spoil", [renamed, with_a_stray_file, with_a_changed_picture])
def test_what_the_way_home_is_not_read_in_does_not_keep_the_arm_from_leaving(
    run: Path, spoil: Callable[[Path], Path]
) -> None:
    found = inspected(spoil(run))
    with pytest.raises(RunChanged):
        found.require_unchanged()
    assert found.require_account().changes != ()


def gone_home(run: Path) -> None:
    """What `home` leaves: the run taken up in spite of the changes, closed and sealed."""
    left = read_left_run(run, only_leaving=True)
    journal = Journal.taken_up(run, left.chain)
    journal.write(Entry.RESTARTED, 0.0, **left.as_plain())
    close_run(run, journal, 0.0, "left", None)
    seal_run(run)


def test_going_home_does_not_make_an_added_file_part_of_the_run(run: Path) -> None:
    stray = with_a_stray_file(run) / "notes.txt"
    for _ in range(2):
        gone_home(run)
        assert [problem.file for problem in inspected(run).problems] == ["notes.txt"]
    stray.unlink()
    assert inspected(run).problems == ()


def test_going_home_does_not_vouch_for_a_changed_file(run: Path) -> None:
    plan = run / "case" / "plan.toml"
    as_it_was = plan.read_bytes()
    plan.write_bytes(b"schema = 2\n")
    for _ in range(2):
        gone_home(run)
        assert inspected(run).problems == (Problem("case/plan.toml", "changed"),)
    plan.write_bytes(as_it_was)
    assert inspected(run).problems == ()


@pytest.mark.hazard(39)
@pytest.mark.parametrize("name", [JOURNAL_FILE, "records/01-image.json"])
def test_a_changed_account_keeps_the_arm_where_it_is(run: Path, name: str) -> None:
    (run / name).write_bytes((run / name).read_bytes().replace(b"image", b"imagf"))
    with pytest.raises(RunChanged, match=name):
        inspected(run).require_account()


def test_exports_are_made_at_any_time_and_are_no_part_of_the_run(run: Path) -> None:
    (run / "export").mkdir()
    (run / "export" / "spheres.csv").write_text("M1")
    assert inspected(run).problems == ()
