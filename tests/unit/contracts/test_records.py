import json
from pathlib import Path

import pytest

from ronna_hw.records import BadRecord, Record, RecordExists, read_record, write_record, write_whole


def test_a_record_is_read_back_equal(tmp_path: Path) -> None:
    record = Record("01-ct_import", "ct_import", {}, {"shape": [2, 3, 4]})
    assert read_record(write_record(record, tmp_path)) == record


@pytest.mark.hazard(1)
def test_a_changed_record_is_refused(tmp_path: Path) -> None:
    path = write_record(Record("02-plan", "plan", {"01-ct_import": "ab"}, {"margin_mm": 2.0}), tmp_path)
    content = json.loads(path.read_text())
    content["payload"]["margin_mm"] = 20.0
    path.write_text(json.dumps(content))
    with pytest.raises(BadRecord, match="does not match its hash"):
        read_record(path)


@pytest.mark.parametrize("text", ["", "{}", '{"identifier": 1'])
def test_a_torn_record_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "torn.json"
    path.write_text(text)
    with pytest.raises(BadRecord):
        read_record(path)


@pytest.mark.hazard(1)
def test_the_hash_covers_parents_and_payload_but_not_the_date() -> None:
    one = Record("a", "k", {"p": "1"}, {"x": 1}, created="2026-01-01")
    assert one.sha256 == Record("b", "k", {"p": "1"}, {"x": 1}, created="2026-02-02").sha256
    assert one.sha256 != Record("a", "k", {"q": "1"}, {"x": 1}).sha256
    assert one.sha256 != Record("a", "k", {"p": "1"}, {"x": 2}).sha256


def test_a_file_that_cannot_be_written_whole_leaves_nothing_behind(tmp_path: Path) -> None:
    target = tmp_path / "folder"
    target.mkdir()
    with pytest.raises(OSError):  # noqa: PT011 - which one depends on the system
        write_whole(target, b"a folder of that name exists")
    assert list(tmp_path.iterdir()) == [target]


def test_a_record_is_never_written_twice(tmp_path: Path) -> None:
    first = Record("01-ct_import", "ct_import", {}, {"slices": 3})
    path = write_record(first, tmp_path)
    with pytest.raises(RecordExists, match="REC-002"):
        write_record(Record("01-ct_import", "ct_import", {}, {"slices": 4}), tmp_path)
    assert read_record(path) == first
    assert list(tmp_path.iterdir()) == [path]
