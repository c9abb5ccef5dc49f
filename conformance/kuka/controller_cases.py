"""Cases for a KUKA controller on RSI and EKI, bypassing the driver.

The number of a case is K and a line of the protocol's checklist. Without `--allow motion` all corrections are
zero: the program starts, streams and ends, and the arm stays where it is.
"""

from __future__ import annotations

import itertools
import math
import re
import statistics
import time
from collections.abc import Callable

from conformance.case import DESTRUCTIVE, HOST_TIME, MOTION, CaseList, NotShown, check, require_present
from conformance.device_under_test import DeviceUnderTest
from conformance.kuka.client import (
    AXES,
    FIRST_LIMIT_S,
    HOLD,
    EkiLine,
    RsiLine,
    Telegram,
    command,
    eki_line,
    idle_controller,
    stream,
)
from ronna_hw.arm.kr6_r900 import R900_2, SIXX, kr6_r900
from ronna_hw.arm.pose import Pose, radians6
from ronna_hw.wire.kuka_context import SendElement

PERIODS = 1000
PERIOD_TOLERANCE = 0.01
FEW = 20  # cycles, when a handful is enough
MISSED = 4  # replies omitted: far below any Timeout
SETTLING = 250  # cycles until the arm has followed a small correction, one second at 4 ms
TURN_DEG = 0.05
FOLLOWED_DEG = 0.01  # for a small turn; backlash and repeatability are smaller
STANDS_STILL_DEG = 0.001
FRAME_TOLERANCE = 0.001  # mm or deg, in addition to rounding on the wire
LONGEST_END = 12  # telegrams after a Stop: two cycles and the end of RSI

_TEXT = r"<(\w+)>[^<>\s]*</\1>"
_EMPTY = r'<\w+(?: \w+="[^"<>]*")+/>'
_WHOLE = re.compile(rf'<Rob Type="KUKA">(?:{_EMPTY}|{_TEXT})*<IPOC>\d+</IPOC></Rob>'.encode())
_NUMBER = re.compile(rb'"-?\d+\.(\d+)"')

CASES = CaseList()
case = CASES.case
on_stream = CASES.within(stream)
on_eki = CASES.within(eki_line)


def has_kr_c4_layout(raw: bytes) -> bool:
    """Return whether a parser with fixed KR C4 positions reads the telegram correctly."""
    return _WHOLE.fullmatch(raw) is not None


@case("K01", "the controller sends first")
def controller_sends_first(dut: DeviceUnderTest) -> None:
    with idle_controller(dut) as (eki, ours):
        check(eki.ask("RSI_START") == 0, "a program that starts")
        ours.settimeout(FIRST_LIMIT_S)
        try:
            first = ours.recv(65536)
        except TimeoutError:
            first = b""
        check(first.startswith(b"<Rob"), f"a telegram within {FIRST_LIMIT_S:g} s of the start", first[:40])
        eki.ask("RSI_STOP")


@on_stream(
    "K02", "telegrams come every cycle: the median period over 1,000 is within 1 %", needs=(HOST_TIME,)
)
def period_is_kept(line: RsiLine) -> None:
    telegrams = line.run_cycles(PERIODS + 1)
    periods = [b.received_s - a.received_s for a, b in itertools.pairwise(telegrams)]
    median_ms = 1000 * statistics.median(periods)
    cycle_ms = line.context.program.cycle_ms
    deviation = abs(median_ms - cycle_ms) / cycle_ms
    check(deviation < PERIOD_TOLERANCE, f"a period of {cycle_ms} ms", f"{median_ms:.3f} ms")


@on_stream("K03", "all telegrams of a run come from one port")
def one_sender(line: RsiLine) -> None:
    senders = {telegram.sender for telegram in line.run_cycles(FEW)}
    check(len(senders) == 1, "one sender", senders)


@on_stream(
    "K04", "the root has Type KUKA; double quotes, no white space between elements, no blank before />"
)
def layout_is_exact(line: RsiLine) -> None:
    for telegram in line.run_cycles(FEW):
        check(has_kr_c4_layout(telegram.raw), "the layout of a KR C4", telegram.raw[:120])


@on_stream("K05", "elements are in the order of the configuration, IPOC last")
def order_is_kept(line: RsiLine) -> None:
    (telegram,) = line.run_cycles(1)
    found = re.findall(r"<(\w+)[ >]", telegram.raw.decode())[1:]
    tags = [*map(_name_of, line.context.send)]
    tags += [name for name in map(_name_of, line.context.optional_send) if name in found]
    wanted = [*(tag for tag, _ in itertools.groupby(tags) if tag != "FREE"), "IPOC"]
    check(found == wanted, f"the order {' '.join(wanted)}", " ".join(found))


def _name_of(element: SendElement) -> str:
    return element.tag.removeprefix("DEF_").partition(".")[0]


@on_stream("K07", "EIPos always has six values")
def six_external_axes(line: RsiLine) -> None:
    (telegram,) = line.run_cycles(1)
    check(len(telegram.values("EIPos")) == len(AXES), "six values", telegram.values("EIPos"))


@on_stream("K08", "numbers have as many decimals as Precision states")
def precision_is_kept(line: RsiLine) -> None:
    (telegram,) = line.run_cycles(1)
    digits = {len(match) for match in _NUMBER.findall(telegram.raw)}
    wanted = line.context.ethernet.precision
    check(digits == {wanted}, f"{wanted} decimals", digits)


@on_stream("K09", "the delay D is an integer")
def delay_is_whole(line: RsiLine) -> None:
    for telegram in line.run_cycles(FEW):
        check(telegram.late >= 0, "at least 0", telegram.late)


@on_stream("K10", "IPOC increases by the cycle time in every telegram")
def time_stamps_grow(line: RsiLine) -> None:
    stamps = [telegram.ipoc for telegram in line.run_cycles(PERIODS // 10)]
    steps = {b - a for a, b in itertools.pairwise(stamps)}
    check(steps == {line.context.program.cycle_ms}, f"{line.context.program.cycle_ms} each time", steps)


@on_stream("K14", "a reply with a wrong Type, a wrong IPOC or broken XML does not count", needs=(HOST_TIME,))
def wrong_replies_count_as_none(line: RsiLine) -> None:
    wrong: dict[str, Callable[[Telegram], bytes]] = {
        "a wrong Type": lambda t: line.reply(t.ipoc, sentype="Stranger"),
        "an IPOC of the past": lambda t: line.reply(t.ipoc - 10_000),
        "an IPOC of the future": lambda t: line.reply(t.ipoc + 10_000),
        "broken XML": lambda t: line.reply(t.ipoc)[:-6],
        "text for a number": lambda t: line.reply(t.ipoc).replace(b'"0.0000"', b'"zero"', 1),
    }
    for what, reply in wrong.items():
        line.run_cycles(FEW)
        # One at a time: over many cycles a busy computer adds late replies of its own.
        for _ in range(MISSED):
            telegram = line.next()
            line.send(telegram, reply(telegram))
            after = line.next()
            line.answer(after)
            check(after.late > telegram.late, f"{what} counted as late", after.late)


@on_stream("K15", "one late reply does not make the following ones late", needs=(HOST_TIME,))
def late_reply_shifts_nothing(line: RsiLine) -> None:
    before = line.run_cycles(FEW)[-1]
    missed = line.next()
    current = line.next()
    line.answer(missed)  # one cycle late, right before the current one
    line.answer(current)
    after = line.run_cycles(5 * FEW)[-1]
    check(after.late - before.late < FEW, "one late reply, not one each cycle", after.late - before.late)


@on_stream("K16", "HOLDON 1 keeps the correction while replies are missing", needs=(MOTION, HOST_TIME))
def correction_is_held(line: RsiLine) -> None:
    if any(element.holdon != 1 for element in line.context.receive if element.tag.startswith("AK")):
        raise NotShown("the context's corrections do not have HOLDON 1")
    base, turn = _turn_axis_6(line)
    # Without the hold the arm would turn back within some cycles, and return some cycles later.
    seen = [line.next() for _ in range(MISSED)] + line.run_cycles(FEW, turn)
    held = [telegram.values("AIPos")["A6"] - base for telegram in seen]
    _undo_turn(line)
    for angle in held:
        check(abs(angle - TURN_DEG) < FOLLOWED_DEG, f"A6 {TURN_DEG} deg from its start", angle)


@on_stream(
    "K17", "missing replies are counted in D; at the Timeout the run ends", needs=(DESTRUCTIVE, HOST_TIME)
)
def timeout_ends_the_run(line: RsiLine) -> None:
    line.run_cycles(FEW)
    rest = line.await_silence(with_replies=False)
    limit = line.context.ethernet.timeout_packets
    check(limit // 2 <= len(rest) <= limit + FEW, f"about {limit} more telegrams", len(rest))
    check(rest[-1].late - rest[0].late >= limit // 2, "an increasing D", rest[-1].late)
    state = line.eki.state()
    check(state.get("RSI") == "3", "RSI in fault", state.get("RSI"))
    check(state.get("Err") != "0", "a message", state.get("Err"))


@on_stream(
    "K20", "ABSOLUTE: the arm goes to its start plus the correction, and back at zero", needs=(MOTION,)
)
def correction_is_absolute(line: RsiLine) -> None:
    if line.context.program.corrections != "absolute":
        raise NotShown("the context uses relative corrections")
    base, turn = _turn_axis_6(line)
    there = line.run_cycles(SETTLING, turn)[-1].values("AIPos")["A6"]
    back = _undo_turn(line)
    check(abs(there - base - TURN_DEG) < FOLLOWED_DEG, f"A6 {TURN_DEG} deg from its start", there - base)
    check(abs(back - base) < FOLLOWED_DEG, "A6 back at its start", back - base)


@case("K21", "the first telegram has the axes that the controller reported before the start")
def starts_where_it_stands(dut: DeviceUnderTest) -> None:
    with idle_controller(dut) as (eki, _):
        axis = require_present(eki.state().find("Axis"), "an Axis in the state")
    before = {name: float(axis.get(name, "nan")) for name in AXES}
    with stream(dut) as line:
        (first,) = line.run_cycles(1)
    moved = max(abs(first.values("AIPos")[name] - before[name]) for name in AXES)
    check(moved < STANDS_STILL_DEG, "the same axes", f"{moved:.5f} deg apart")


@on_stream("K25", "RIst is the pose of the flange for AIPos, with tool and base")
def pose_agrees_with_axes(line: RsiLine) -> None:
    telegram = line.run_cycles(FEW)[-1]
    state = line.eki.state()
    if state.get("Base") != "0":
        raise NotShown("a base is active")
    if (variant := state.get("Variant", "")) not in (SIXX, R900_2):
        raise NotShown(f"the controller states no arm that is known here: {variant!r}")
    model = kr6_r900(variant)
    axes, tool = telegram.values("AIPos"), telegram.values("RIst")
    flange = model.forward(radians6(*(axes[name] for name in AXES)))
    pose = Pose.from_kuka(*(tool[name] for name in ("X", "Y", "Z", "A", "B", "C")))
    apart_mm, turned_deg = flange.distance_mm(pose), math.degrees(flange.angle_rad(pose))
    if apart_mm > 1.0:
        raise NotShown("a tool is active, and its frame is unknown")
    rounding = 10.0**-line.context.ethernet.precision * 20  # one digit of an axis, at a reach of one metre
    check(apart_mm < FRAME_TOLERANCE + rounding, "the position of the flange", f"{apart_mm:.4f} mm off")
    check(
        turned_deg < FRAME_TOLERANCE + rounding, "the orientation of the flange", f"{turned_deg:.4f} deg off"
    )


@on_stream("K27", "a rising edge of Stop ends the stream within a few cycles")
def stop_ends_the_stream(line: RsiLine) -> None:
    line.run_cycles(FEW)
    line.answer(line.next(), stop=True)
    rest = line.await_silence()
    check(len(rest) <= LONGEST_END, f"at most {LONGEST_END} more telegrams", len(rest))


@case("K28", "a new run has a new time base and a new port, and starts without a jump")
def new_run_new_base(dut: DeviceUnderTest) -> None:
    with stream(dut) as line:
        first = line.run_cycles(FEW)
    with stream(dut) as line:
        again = line.run_cycles(FEW)
    stamps = {telegram.ipoc for telegram in first}
    stamps.add(first[-1].ipoc + line.context.program.cycle_ms)
    check(again[0].ipoc not in stamps, "a different IPOC", again[0].ipoc)
    check(first[-1].sender != again[0].sender, "another port", again[0].sender)
    moved = max(abs(again[0].values("AIPos")[name] - first[-1].values("AIPos")[name]) for name in AXES)
    check(moved < STANDS_STILL_DEG, "the same axes", f"{moved:.5f} deg apart")


def _turn_axis_6(line: RsiLine) -> tuple[float, dict[str, float]]:
    """Turn A6 slightly in even steps; returns the initial angle and the corrections that hold the new one."""
    telegrams: list[Telegram] = line.run_cycles(FEW)
    base = telegrams[-1].values("AIPos")["A6"]
    for share in range(1, FEW + 1):
        line.run_cycles(1, {**HOLD, "A6": TURN_DEG * share / FEW})
    turn = {**HOLD, "A6": TURN_DEG}
    line.run_cycles(SETTLING, turn)
    return base, turn


def _undo_turn(line: RsiLine) -> float:
    """Turn A6 back in even steps and return the final angle."""
    for share in range(FEW, -1, -1):
        line.run_cycles(1, {**HOLD, "A6": TURN_DEG * share / FEW})
    return line.run_cycles(SETTLING)[-1].values("AIPos")["A6"]


PADDED_BYTES = 500  # as the C++ SDK pads every request
BETWEEN_SPLITS_S = 0.03
CYCLES = 50


@on_eki("K34", "one client per channel; nothing is written between elements")
def one_client(first: EkiLine) -> None:
    first.state()
    with EkiLine(first.endpoint) as second:
        second.command("STATUS")
        check(second.is_closed_by_controller(), "a second client that is refused")
    first.state()
    check(first.between == b"", "no byte between elements", first.between)


@on_eki("K35", "requests may be padded with NUL, split, or sent several at once")
def requests_by_element_end(line: EkiLine) -> None:
    line.send(command("padded", "STATUS").ljust(PADDED_BYTES, b"\0"))
    line.answer("State", "padded")
    for piece in (b'<Cmd Id="pie', b'ces" Name="STA', b'TUS"></Cmd>'):
        line.send(piece)
        time.sleep(BETWEEN_SPLITS_S)
    line.answer("State", "pieces")
    line.send(command("one", "STATUS") + command("two", "STATUS"))
    line.answer("State", "one")
    line.answer("State", "two")


@on_stream("K40", "the stream outlives a lost connection, and the state still reports it")
def connection_is_lost(line: RsiLine) -> None:
    line.run_cycles(5)
    line.eki.reconnect()
    line.run_cycles(CYCLES)
    check(line.eki.state().get("RSI") == "2", "RSI still in MOVECORR after a new connection")
