"""Series of the inbox: how far they have come, what is refused, and how a person takes one into a case."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pydicom
import pytest
from coded_errors import raises
from dicom_stand import settle_at_once, store_all, write_patient
from pydicom.dataset import Dataset

from procedures.exchange.dicom_network import errors
from procedures.exchange.dicom_network.arrivals import INCOMING, Arrivals
from procedures.exchange.dicom_network.inbox import InboxEntry, SeriesState, find_series, list_series
from procedures.exchange.dicom_network.taking import take_series
from procedures.imaging.series import read_series
from procedures.operator.question import ReadBack
from ronna_hw.command_line.errors import PATH_PROBLEM

OpenInbox = Callable[..., Arrivals]


@pytest.fixture
def inbox(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    settle_at_once(monkeypatch)
    return tmp_path / "inbox"


@pytest.fixture
def open_inbox(inbox: Path) -> Iterator[OpenInbox]:
    opened: list[Arrivals] = []

    def open_one(**options: Any) -> Arrivals:
        opened.append(Arrivals(inbox, options.pop("report", lambda _entry: None), **options))
        return opened[-1]

    yield open_one
    for one in opened:
        one.close()


@pytest.mark.parametrize(
    ("at_source", "state", "complete", "reason"),
    [
        (4, SeriesState.COMPLETE, True, ""),
        (6, SeriesState.ARRIVING, False, "2 of 6 slices are missing"),
        (3, SeriesState.UNKNOWN, "unknown", "4 slices have arrived, the source has 3"),
        (0, SeriesState.UNKNOWN, "unknown", "the source does not know this series"),
    ],
)
def test_the_source_says_whether_a_series_is_complete(
    inbox: Path,
    open_inbox: OpenInbox,
    tmp_path: Path,
    at_source: int,
    state: str,
    complete: object,
    reason: str,
) -> None:
    reported: list[InboxEntry] = []
    arrivals = open_inbox(report=reported.append, count_at_source=lambda _study, _series: at_source)
    store_all(arrivals, write_patient(tmp_path / "sent", "anna"))
    arrivals.settle()
    (entry,) = list_series(inbox)
    assert reported == [entry]
    assert (entry.state, entry.record.complete, entry.record.reason) == (state, complete, reason)


def test_a_source_that_does_not_answer_leaves_the_series_unknown_and_says_why(
    inbox: Path, open_inbox: OpenInbox, tmp_path: Path
) -> None:
    def fail(_study: str, _series: str) -> int:
        raise errors.NO_PEER("no answer from PACS@host:104")

    arrivals = open_inbox(count_at_source=fail)
    store_all(arrivals, write_patient(tmp_path / "sent", "anna"))
    arrivals.settle()
    (entry,) = list_series(inbox)
    assert entry.state is SeriesState.UNKNOWN
    assert "DCM-005" in entry.record.reason


def test_a_gap_is_reported_with_the_code_by_which_a_case_would_refuse_it(
    inbox: Path, open_inbox: OpenInbox, tmp_path: Path
) -> None:
    folder = write_patient(tmp_path / "sent", "anna", slices=6)
    (folder / "0002.dcm").unlink()
    arrivals = open_inbox()
    store_all(arrivals, folder)
    arrivals.settle()
    assert list_series(inbox)[0].record.problem.startswith("CT-010")


def test_a_series_without_end_holds_up_no_other_and_a_late_slice_reopens_one(
    inbox: Path, open_inbox: OpenInbox, tmp_path: Path
) -> None:
    reported: list[str] = []
    arrivals = open_inbox(report=lambda entry: reported.append(entry.record.study_instance_uid))
    whole, endless = (write_patient(tmp_path / name, name) for name in ("anna", "boris"))
    store_all(arrivals, whole)
    arrivals.settle()
    store_all(arrivals, endless)
    assert len(reported) == 1
    assert [one.state for one in list_series(inbox)] == [SeriesState.UNKNOWN, SeriesState.ARRIVING]
    store_all(arrivals, whole)
    assert [one.state for one in list_series(inbox)] == [SeriesState.ARRIVING] * 2
    arrivals.settle()
    assert [one.record.instances for one in list_series(inbox)] == [4, 4]  # repeats replaced the same slices


def test_a_killed_receiver_leaves_no_half_object_and_its_series_is_judged_at_the_next_start(
    inbox: Path, open_inbox: OpenInbox, tmp_path: Path
) -> None:
    first = open_inbox()
    store_all(first, write_patient(tmp_path / "sent", "anna"))
    (inbox / INCOMING / "7.part").write_bytes(b"half")
    first.close()
    first.close = lambda: None  # type: ignore[method-assign]
    open_inbox().settle()
    assert not list((inbox / INCOMING).glob("*.part"))
    assert list_series(inbox)[0].state is SeriesState.UNKNOWN


def test_a_second_receiver_of_the_same_inbox_is_refused(open_inbox: OpenInbox) -> None:
    open_inbox()
    with raises(PATH_PROBLEM, match="another receiver"):
        open_inbox()


def _forge(**values: str) -> Callable[[Dataset, int], None]:
    return lambda data, _place: data.update(values)


def _shorten(data: Dataset, _place: int) -> None:
    data.PixelData = data.PixelData[:-2]


@pytest.mark.filterwarnings("ignore:(Invalid value|The value length).* for VR UI")
@pytest.mark.parametrize(
    ("edit", "reason"),
    [
        (_forge(SeriesInstanceUID="../../evil"), "no DICOM identifier"),
        (_forge(SeriesInstanceUID="1." + "2" * 70), "no DICOM identifier"),
        (_forge(StudyInstanceUID="2.25.7"), "another study"),
        (_forge(PatientID="boris"), "another patient"),
        (_forge(SOPClassUID="1.2.840.10008.5.1.4.1.1.4"), "SOPClassUID of the object is not that"),
        (_shorten, "another number of pixels"),
    ],
)
def test_a_forged_object_is_refused_and_nothing_of_it_is_kept(
    inbox: Path, open_inbox: OpenInbox, tmp_path: Path, edit: Callable[[Dataset, int], None], reason: str
) -> None:
    arrivals = open_inbox()
    store_all(arrivals, write_patient(tmp_path / "sent", "anna"))
    before = sorted(inbox.rglob("*"))
    path = sorted(write_patient(tmp_path / "forged", "anna", slices=5, edit=edit).iterdir())[-1]
    uid = str(pydicom.dcmread(path).SOPInstanceUID)
    with raises(errors.OBJECT_REFUSED, match=reason):
        arrivals.store("SCANNER", path.read_bytes(), "1.2.840.10008.5.1.4.1.1.2", uid)
    assert sorted(inbox.rglob("*")) == before


def test_a_disk_that_fills_amid_an_object_keeps_no_part_of_it(
    inbox: Path, open_inbox: OpenInbox, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arrivals = open_inbox()

    def full(_number: int) -> None:
        raise OSError(errno.ENOSPC, "full")

    monkeypatch.setattr(os, "fsync", full)
    with raises(errors.NO_ROOM, match="DCM-010"):
        store_all(arrivals, write_patient(tmp_path / "sent", "anna"))
    assert [one.name for one in inbox.rglob("*") if one.is_file()] == ["lock"]


@pytest.mark.hazard(35)
def test_no_record_of_the_inbox_names_the_patient(inbox: Path, open_inbox: OpenInbox, tmp_path: Path) -> None:
    arrivals = open_inbox()
    store_all(arrivals, write_patient(tmp_path / "sent", "SECRET-7"))
    arrivals.settle()
    names = " ".join(str(path) for path in inbox.rglob("*"))
    records = "".join(path.read_text() for path in inbox.rglob("*.json"))
    assert [word for word in ("SECRET", "Secret") if word in names + records] == []


def _answering(*words: str) -> Callable[[ReadBack], str]:
    rest = iter(words)
    return lambda _value: next(rest)


@pytest.fixture
def filled(inbox: Path, open_inbox: OpenInbox, tmp_path: Path) -> Callable[[int | None], Path]:
    def fill(at_source: int | None) -> Path:
        count = None if at_source is None else lambda _study, _series: at_source
        arrivals = open_inbox(count_at_source=count)
        store_all(arrivals, write_patient(tmp_path / "sent", "anna"))
        arrivals.settle()
        return inbox

    return fill


def test_a_complete_series_becomes_the_ct_of_a_case_once_the_patient_is_read_back(
    filled: Callable[[int | None], Path], tmp_path: Path
) -> None:
    inbox, shown = filled(4), list[str]()
    name = list_series(inbox)[0].name[:5]
    take_series(
        inbox, name, tmp_path / "case", lambda _, scan: shown.append(scan.patient.name), _answering("anna")
    )
    assert shown == ["Secret^Name"]
    assert read_series(tmp_path / "case/ct").geometry.shape[0] == 4
    assert list_series(inbox)[0].state is SeriesState.TAKEN
    with raises(PATH_PROBLEM, match="exists"):
        take_series(inbox, name, tmp_path / "case", lambda *_: None, _answering("anna"))


@pytest.mark.hazard(9)
@pytest.mark.parametrize(("at_source", "answers"), [(4, ["boris"]), (4, ["ANNA"]), (None, ["anna", "5"])])
def test_another_patient_or_another_number_of_slices_is_not_taken(
    filled: Callable[[int | None], Path], tmp_path: Path, at_source: int | None, answers: list[str]
) -> None:
    inbox = filled(at_source)
    with raises(errors.READ_BACK_DIFFERS, match="DCM-013") as refused:
        take_series(
            inbox, list_series(inbox)[0].name, tmp_path / "case", lambda *_: None, _answering(*answers)
        )
    assert "anna" not in str(refused.value)
    assert not (tmp_path / "case").exists()


def test_a_series_of_unknown_length_is_taken_once_its_number_of_slices_is_read_back_too(
    filled: Callable[[int | None], Path], tmp_path: Path
) -> None:
    inbox = filled(None)
    take_series(
        inbox, list_series(inbox)[0].name, tmp_path / "case", lambda *_: None, _answering("anna", "4")
    )
    assert len(list((tmp_path / "case/ct").iterdir())) == 4


@pytest.mark.hazard(9)
def test_a_series_that_lacks_slices_is_not_taken(
    filled: Callable[[int | None], Path], tmp_path: Path
) -> None:
    inbox = filled(6)
    with raises(errors.NOT_READY_TO_TAKE, match="2 of 6 slices are missing"):
        take_series(inbox, list_series(inbox)[0].name, tmp_path / "case", lambda *_: None, _answering("anna"))


def test_a_name_that_nothing_or_several_series_have_is_refused(filled: Callable[[int | None], Path]) -> None:
    inbox = filled(4)
    for name in ("", "zz"):
        with raises(errors.NOT_IN_INBOX, match="DCM-011"):
            find_series(inbox, name)


@pytest.mark.hazard(9)
def test_another_object_with_the_identifier_of_one_that_is_there_is_refused_and_a_repeat_is_not(
    inbox: Path, open_inbox: OpenInbox, tmp_path: Path
) -> None:
    arrivals, sent = open_inbox(), write_patient(tmp_path / "sent", "anna")
    for _ in range(2):
        store_all(arrivals, sent)
    before = [path.read_bytes() for path in sorted(inbox.glob("*/ct/*.dcm"))]
    forged = write_patient(tmp_path / "forged", "anna")
    for path in forged.glob("*.dcm"):
        data = pydicom.dcmread(path)
        data.PixelData = bytes(len(data.PixelData))
        data.save_as(path)
    with raises(errors.OBJECT_REFUSED, match="another object with the identifier"):
        store_all(arrivals, forged)
    assert [path.read_bytes() for path in sorted(inbox.glob("*/ct/*.dcm"))] == before


@pytest.mark.hazard(9)
@pytest.mark.parametrize("attribute", ["PatientName", "PatientBirthDate"])
def test_slices_that_name_two_people_under_one_identifier_do_not_become_one_series(
    open_inbox: OpenInbox, tmp_path: Path, attribute: str
) -> None:
    def other(data: Dataset, place: int) -> None:
        setattr(
            data, attribute, ("Petrov^Ivan" if attribute == "PatientName" else "19500101") if place else ""
        )

    with raises(errors.OBJECT_REFUSED, match="another patient"):
        store_all(open_inbox(), write_patient(tmp_path / "sent", "carl", edit=other))


def test_a_series_whose_receiver_ended_before_its_first_slice_goes_on_with_the_next(
    inbox: Path, open_inbox: OpenInbox, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def end(_path: Path, _target: Path) -> None:
        raise KeyboardInterrupt

    sent, first = write_patient(tmp_path / "sent", "anna"), Arrivals(inbox, lambda _entry: None)
    monkeypatch.setattr(Path, "replace", end)
    with pytest.raises(KeyboardInterrupt):
        store_all(first, sent)
    monkeypatch.undo()
    first.close()
    store_all(open_inbox(), sent)
    assert len(list(inbox.glob("*/ct/*.dcm"))) == 4
