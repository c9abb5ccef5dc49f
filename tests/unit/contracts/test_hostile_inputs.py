"""Mutants for every parser of external input: a few, and a million in a soak."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator

import pytest
from bounded_cost import bounded_cost
from good_inputs import PARSER_NAMES
from hostile_inputs import Parser, feed, parsers, taken
from memory_folder import memory_folder

from ronna_hw.bounded_input import InputRefused
from sim.world.world import _FAULTS, _STAND, World

Change = Callable[[tuple[bytes, ...]], bytes]

FEW = 20
MILLION = 1_000_000
SHARES = 10  # of the million, each with a seed of its own, so that several workers take part
TAKE_LONG = ("results of a run", "DICOM JPEG", "DICOM RLE", "DICOM JPEG 2000", "DICOM JPEG-LS")
REFUSING = ("Polaris BX", "Polaris .rom", "EKI", "RSI", "RSI reply")  # most mutants are none of theirs
MUTANTS = {  # of parsers that take some microseconds, and of some that take a tenth of a second
    **dict.fromkeys(TAKE_LONG, 6),
    **dict.fromkeys((*REFUSING, "GVCP", "GVSP", "conformance BX"), 400),
    **dict.fromkeys(("RTDE", "RTDE set-up", "UR dashboard", "UR primary"), 250),
    "Polaris text": 150,
}


@pytest.mark.parametrize("chained", [True, False])
def test_a_refusal_because_of_the_harness_bound_on_memory_is_none(chained: bool) -> None:
    def take(_data: bytes) -> None:
        try:
            raise MemoryError
        except MemoryError as error:
            if chained:
                raise InputRefused("it cannot be read") from error
            raise InputRefused("it cannot be read")  # noqa: B904 - as third parties do

    with pytest.raises(AssertionError, match="it cannot be read"):
        taken(Parser((b"",), take), b"")


@pytest.fixture(scope="module")
def all_parsers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Parser]]:
    with memory_folder(tmp_path_factory.mktemp("hostile")) as folder:
        yield parsers(folder)


def test_a_mistake_of_ours_in_the_room_is_no_refusal(
    all_parsers: dict[str, Parser], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(World, "mount_tool", lambda *_: next(iter(())))
    room = all_parsers["room"]
    with pytest.raises(AssertionError, match="the simulator failed"):
        taken(room, room.good[0])
    assert "StopIteration" in capsys.readouterr().err


def changed(number: int, *way: str | int, to: object) -> Change:
    """One value in one of the good inputs, which is JSON."""

    def change(good: tuple[bytes, ...]) -> bytes:
        inner = whole = json.loads(good[number])
        for key in way[:-1]:
            inner = inner[key]
        inner[way[-1]] = to
        return json.dumps(whole).encode()

    return change


def raw(data: bytes) -> Change:
    return lambda _good: data


def stand_holding_the_ninth(good: tuple[bytes, ...]) -> bytes:
    world = bytearray(good[0])
    _STAND.write(world, 9)
    return bytes(world)


def half_written_faults(good: tuple[bytes, ...]) -> bytes:
    world = bytearray(good[0])
    _FAULTS.write(world, b"now: tracker bump")
    at = world.index(b"now: tracker bump")
    return bytes(world[:at] + b"N" + world[at + 1 :])


def steps_without_end(_good: tuple[bytes, ...]) -> bytes:
    """Events of a case with nine thousand."""
    names = [f"s{number}" for number in range(9000)]
    order = [{"step": name, "title": "", "phase": "", "moves": False} for name in names]
    done = ({"kind": "step", "step": name, "state": "done"} for name in names * 4)
    about = {"version": 1, "number": 1, "host_time": "2026-11-20T12:00:00+00:00", "theatre_time_s": 1.5}
    lines = (json.dumps({**about, "what": what}) for what in ({"kind": "order", "steps": order}, *done))
    return "\n".join([*lines, ""]).encode()


def more_cycles_than_there_are(good: tuple[bytes, ...]) -> bytes:
    event, *_ = map(json.loads, good[0].splitlines())
    link = dict.fromkeys(("late", "lost", "rejected", "turnaround_median_us", "turnaround_p99_us"), 0)
    what = ({"kind": "link", "cycles": cycles, **link} for cycles in (0, "9" * 400))
    lines = ({**event, "theatre_time_s": 9.0 * number, "what": one} for number, one in enumerate(what))
    return b"".join(json.dumps(line).encode() + b"\n" for line in lines)


LINK = ("payload", "link")
FAR_AWAY = [b"%d,%d,%d" % (i % 90, -i % 90, i % 50) for i in range(20_000)]
FAR_AWAY += [b"%de%d,0,0" % (i + 1, 200 + i % 100) for i in range(19_000)]
FOUND: dict[str, tuple[str, Change]] = {
    "a plan without the registered target": (
        "results of a run",
        changed(2, "payload", "plan", "trajectories", to=[]),
    ),
    "events of more cycles than there are": ("events", more_cycles_than_there_are),
    "events of steps without end": ("events", steps_without_end),
    "spheres left out that are none": ("results of a run", changed(9, "payload", "left_out", to=[1])),
    "more spheres than looks": ("results of a run", changed(9, "payload", "looks", to=[1])),
    "fewer counts than bins": ("results of a run", changed(11, *LINK, "histogram_counts", to=[1])),
    "fewer counts of jitter": ("results of a run", changed(11, *LINK, "jitter_counts", to=[1])),
    "bins that descend": ("results of a run", changed(11, *LINK, "histogram_edges_us", to=[100, 10, 0])),
    "fewer telegrams than none": ("results of a run", changed(11, *LINK, "histogram_counts", to=[-10, 1])),
    "an unknown key of 10 MB": ("looks of a calibration", raw(b'{"' + b"a" * 10_000_000 + b'": 1}')),
    "a structure far away": ("structure", raw(b"\n".join(FAR_AWAY))),
    "a head far away": ("head of a scene", raw(b"[head]\ncentre_ct_mm=[1e9,0,0]\nsemi_axes_mm=[75,95,85]")),
    "a level for a name of 60,000 parts": ("variables", raw(b"ronna-sim" + b".a" * 60_000 + b"=debug")),
    "a world cut short": ("world", lambda good: good[0][:10_000]),
    "a world without a scene": ("world", lambda good: good[0][:-1]),
    "a world with a ninth thing on its stand": ("world", stand_holding_the_ninth),
    "a fault script written half": ("world", half_written_faults),
    "a description of 4 GB": ("conformance features", raw(b"Local:cam.xml;10000;ffffffff\n")),
    "a description at no address": ("conformance features", raw(b"Local:cam.xml;-1;20\n")),
    "a register of 4 GB": (
        "conformance features",
        lambda good: good[0].replace(b"<Length>4<", b"<Length>4294967295<", 1),
    ),
    "a leader cut short": ("conformance stream", raw(bytes(4) + b"\1\0\0\0" + bytes(4))),
    "elements without an end": ("conformance EKI", raw(b"<a>" * 30_000)),
    "a code that is no number": ("conformance EKI", raw(b'<Ack Id="7" Code="x"></Ack>')),
    "an axis that is no number": ("conformance RSI", raw(b'<Rob><AIPos A1="x"/></Rob>')),
    "an IPOC of 5,000 digits": ("conformance RSI", raw(b"<IPOC>" + b"1" * 5000 + b"</IPOC>")),
    "no count of handles": ("conformance Polaris", raw(b"OKAY")),
}


@pytest.mark.parametrize("what", FOUND)
def test_what_was_found_is_refused_at_bounded_cost(all_parsers: dict[str, Parser], what: str) -> None:
    name, change = FOUND[what]
    with bounded_cost():
        taken(all_parsers[name], change(all_parsers[name].good))


@pytest.mark.parametrize("name", PARSER_NAMES)
def test_a_parser_accepts_valid_input_and_reads_or_refuses_mutants(
    all_parsers: dict[str, Parser], name: str
) -> None:
    parser = all_parsers[name]
    for good in parser.good:
        parser.take(good)
    count = MUTANTS.get(name, FEW)
    with bounded_cost():
        read = feed(parser, count, seed=1)
    if name in REFUSING:
        assert 0 < read < 0.6 * count


@pytest.mark.soak
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("seed", range(400, 400 + SHARES))
@pytest.mark.parametrize("name", PARSER_NAMES)
def test_a_million_mutants_cost_a_bounded_amount(
    all_parsers: dict[str, Parser], name: str, seed: int
) -> None:
    with bounded_cost(limit_s=3600.0):  # each has its own limit
        feed(all_parsers[name], MILLION // SHARES, seed)
