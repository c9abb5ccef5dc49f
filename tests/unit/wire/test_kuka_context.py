"""The RSI context description: ours is complete, and an invalid one reports all its mistakes."""

from pathlib import Path

import pytest
from coded_errors import raises

from ronna_hw.wire.kuka_context import CONTEXT_INVALID, DEFAULT_CONTEXT_FILE, context_hash, load_context

OURS = Path(__file__).parents[3] / "ronna_hw" / "wire" / DEFAULT_CONTEXT_FILE


def _edited(tmp_path: Path, *changes: tuple[str, str]) -> Path:
    text = OURS.read_text("utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = tmp_path / "context.toml"
    path.write_text(text, "utf-8")
    return path


def test_our_context_freezes_the_arm_when_packets_are_lost() -> None:
    context = load_context()
    assert context.program.corrections == "absolute"
    assert all(e.holdon == 1 for e in context.receive if e.tag.startswith("AK."))
    assert context.ethernet.timeout_packets == 100
    assert context.ethernet.precision == 4
    assert context.axis_monitor is not None


def test_every_axis_and_the_stop_are_wired() -> None:
    context = load_context()
    assert [context.find_wired_tag("AXISCORR", f"A{n}") for n in range(1, 7)] == [
        f"AK.A{n}" for n in range(1, 7)
    ]
    assert context.find_wired_tag("STOP", "In1") == "Stop"
    assert context.find_wired_tag("POSCORR", "X") is None


def test_the_hash_covers_the_meaning_but_not_the_address_of_the_pc(tmp_path: Path) -> None:
    ours = context_hash(load_context())
    assert context_hash(load_context(_edited(tmp_path, ('"192.168.10.20"', '"192.168.10.99"')))) == ours
    assert context_hash(load_context(_edited(tmp_path, ("# The one", "# One")))) == ours
    assert context_hash(load_context(_edited(tmp_path, ("cycle_ms = 4 ", "cycle_ms = 12 ")))) != ours
    assert context_hash(load_context(_edited(tmp_path, ("holdon = 1", "holdon = 0")))) != ours


def test_all_three_mistakes_of_a_context_are_reported(tmp_path: Path) -> None:
    path = _edited(
        tmp_path,
        ("cycle_ms = 4 ", "cycle_ms = 5 "),
        ("precision = 4", "precison = 4"),
        ("holdon = 0", "holdon = 2"),
    )
    with raises(CONTEXT_INVALID) as caught:
        load_context(path)
    assert caught.value.code == "WIR-001"
    assert "3 mistakes" in str(caught.value)
    for name in ("program.cycle_ms", "ethernet.precison", "receive 1.holdon"):
        assert name in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("indx = 7\nholdon = 1", "indx = 6\nholdon = 1", "used once"),
        ('indx = 7\nobject = "AXISCORR"', 'indx = 9\nobject = "AXISCORR"', "not received"),
        ('input = "A6"', 'input = "A5"', "fed once"),
        ('"DEF_RIst"\ntype = "DOUBLE"\nindx = "INTERNAL"', '"DEF_RIst"\ntype = "DOUBLE"\nindx = 3', "DEF_"),
    ],
)
def test_conflicting_channels_are_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    with raises(CONTEXT_INVALID, match=said):
        load_context(_edited(tmp_path, (old, new)))


def test_a_missing_or_broken_file_is_refused_with_a_clear_reason(tmp_path: Path) -> None:
    with raises(CONTEXT_INVALID, match="cannot read"):
        load_context(tmp_path / "absent.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text("schema = ", "utf-8")
    with raises(CONTEXT_INVALID, match="not TOML"):
        load_context(broken)
