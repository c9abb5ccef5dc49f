import json
import os
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import Any

import pytest
from bounded_cost import bounded_cost
from coded_errors import raises

from ronna_hw.records import RECORD_EXISTS, BadRecord, Record, read_record, write_atomically, write_record


def test_a_record_is_read_back_equal(tmp_path: Path) -> None:
    record = Record("01-ct_import", "ct_import", {}, {"shape": [2, 3, 4]})
    assert read_record(write_record(record, tmp_path)) == record


@pytest.mark.hazard(1)
@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ('"x": 1', '"x": 2', "does not match its hash"),
        ("payload", "pay", "it has an unknown field 'pay'"),
        ('"run"', '"x"', "it has no 'run'"),
        ("{", " {", "was rewritten"),
    ],
)
def test_an_altered_or_reformatted_record_is_refused(tmp_path: Path, old: str, new: str, what: str) -> None:
    path = write_record(Record("a", "k", {"p": "1"}, {"x": 1}), tmp_path)
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(BadRecord, match=what):
        read_record(path)


@pytest.mark.parametrize("text", ["", "{}", '{"identifier": 1', '"text"', "[" * 100_000, '{"sha256": NaN'])
def test_a_malformed_record_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "torn.json"
    path.write_text(text)
    with pytest.raises(BadRecord):
        read_record(path)


@pytest.mark.hazard(1)
@pytest.mark.parametrize(
    "change",
    [
        {"identifier": "b"},
        {"kind": "l"},
        {"parents": {"q": "1"}},
        {"payload": {"x": 2}},
        {"run": "another"},
        {"series": "1.2.4"},
        {"trajectory": "T2"},
        {"created": "2026-02-02"},
        {"version": 2},
    ],
    ids=lambda change: next(iter(change)),
)
def test_the_hash_covers_every_field_of_a_record(change: dict[str, Any]) -> None:
    one = Record("a", "k", {"p": "1"}, {"x": 1}, 1, "run", "1.2.3", "T1", "2026-01-01")
    assert replace(one, **change).sha256 != one.sha256


@pytest.mark.parametrize(
    "own_hash",
    [pytest.param(True, id="own hash"), pytest.param(False, id="another hash", marks=pytest.mark.slow)],
)
def test_a_record_of_nested_lists_is_refused_at_bounded_cost(tmp_path: Path, own_hash: bool) -> None:
    nested = [reduce(lambda inner, _: [inner], range(50), 0) for _ in range(19_000)]
    record = Record("a", "k", {}, {"x": nested})
    path = write_record(Record("a", "k", {}, {"x": 1}), tmp_path)
    content = json.loads(path.read_text()) | {"payload": record.payload, "created": record.created}
    path.write_text(
        json.dumps(content | ({"sha256": record.sha256} if own_hash else {}), separators=(",", ":"))
    )
    del record, nested, content
    with bounded_cost(), pytest.raises(BadRecord, match="was rewritten" if own_hash else "match its hash"):
        read_record(path)


def test_a_pipe_in_place_of_a_record_is_refused_without_blocking(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.json")
    with pytest.raises(BadRecord, match=r"REC-001.*not a regular file"):
        read_record(tmp_path / "a.json")


def test_a_failed_write_leaves_no_temporary_file(tmp_path: Path) -> None:
    target = tmp_path / "folder"
    target.mkdir()
    with pytest.raises(OSError):  # noqa: PT011 - which one depends on the system
        write_atomically(target, b"a folder of that name exists")
    assert list(tmp_path.iterdir()) == [target]


def test_a_failed_write_names_the_missing_folder_or_the_file_never_the_temporary_one(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    for path, named in (
        ("absent/a.json", "absent"),
        ("file/a.json", "file"),
        ("folder", "folder"),
        (f"{'a' * 300}.json", f"{'a' * 300}.json"),
    ):
        with pytest.raises(OSError) as refused:  # noqa: PT011 - which one depends on the case
            write_atomically(tmp_path / path, b"{}")
        assert (refused.value.filename, refused.value.filename2) == (str(tmp_path / named), None)
        assert "->" not in str(refused.value)
    with pytest.raises(FileExistsError) as refused:
        write_atomically(tmp_path / "file", b"{}", exclusive=True)
    assert (refused.value.filename, refused.value.filename2) == (str(tmp_path / "file"), None)


def test_an_interrupted_write_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(_file: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("ronna_hw.records.os.fsync", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_atomically(tmp_path / "result.json", b"{}")
    assert list(tmp_path.iterdir()) == []


def test_a_record_is_never_overwritten(tmp_path: Path) -> None:
    first = Record("01-ct_import", "ct_import", {}, {"slices": 3})
    path = write_record(first, tmp_path)
    with raises(RECORD_EXISTS, match="REC-002"):
        write_record(Record("01-ct_import", "ct_import", {}, {"slices": 4}), tmp_path)
    assert read_record(path) == first
    assert list(tmp_path.iterdir()) == [path]
