"""Every fault of the robot, by script, and what a client sees of it: over UDP and TCP, in lock-step."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from itertools import pairwise

import pytest
from kuka_clients import Cell, EkiClient, RsiClient

from sim.theatre.built_in import built_in_scene
from sim.theatre.door import ask_room
from sim.theatre.world import World

CYCLE_S = 0.004


class Stage:
    """One controller for all tests, brought back to rest between them."""

    def __init__(self, stack: ExitStack) -> None:
        self.world = World.create(built_in_scene("mini", seed=5), paced=False)
        self._cell = Cell(stack, world=self.world)
        self.rsi: RsiClient = self._cell.rsi
        self.eki: EkiClient = self._cell.project()

    def begin(self) -> None:
        """RSI streams, corrections act, nothing is wrong."""
        self.world.set_fault_script("")
        self.reconnect()
        self.eki.state(Mode="EXT", EStop="0", Guard="0")
        self.eki.command("CANCEL")
        assert self.eki.command("ACK_ERRORS") == 0
        self.eki.state(RSI="0", Moving="0")
        self.rsi.forget()
        self._cell.start(self.eki)
        self.rsi.cycles(10)
        self.eki.state(RSI="2")

    def inject(self, fault: str, *others: str) -> None:
        """Faults from now on, and only these."""
        begin_s = self.world.clock.now_s() - CYCLE_S / 4  # in lock-step the time stands while a client works
        lines = (f"at {begin_s:.6f} s: robot {line}" for line in (fault, *others))
        self.world.set_fault_script("\n".join(lines))

    def reconnect(self) -> EkiClient:
        self.eki.close()
        self.eki = self._cell.project()
        return self.eki

    def sdk(self) -> EkiClient:
        return self._cell.sdk()

    def move(self, goal_deg: float, cycles: int = 200, begin_deg: float = 0.0) -> list[float]:
        """A1 to a correction; the measured angle of every telegram."""
        return self.rsi.move_axis(goal_deg, cycles, begin_deg)


@pytest.fixture(scope="module")
def the_stage() -> Iterator[Stage]:
    with ExitStack() as stack:
        yield Stage(stack)


@pytest.fixture
def stage(the_stage: Stage) -> Stage:
    the_stage.begin()
    return the_stage


def on_a1(value: float) -> tuple[float, ...]:
    return (value, 0.0, 0.0, 0.0, 0.0, 0.0)


def largest_step(angles: Sequence[float]) -> float:
    return max(abs(b - a) for a, b in pairwise(angles))


def rests_at(stage: Stage, correction_deg: float, base_deg: float) -> bool:
    stage.rsi.cycles(100, on_a1(correction_deg))
    return stage.rsi.axes_deg[0] == pytest.approx(base_deg + correction_deg, abs=1e-4)


# -- the RSI link


@pytest.mark.parametrize(
    ("fault", "late"),
    [
        ("drop 100 % for 0.1 s", 25),
        ("delay 2 cycles for 0.1 s", 25),
        ("corrupt replies 100 % for 0.1 s", 25),
        ("duplicate 100 % for 0.1 s", 0),
        ("delay 0 cycles for 0.1 s", 0),
    ],
)
def test_replies_that_do_not_arrive_whole_and_in_time_are_late_cycles_and_nothing_moves_by_them(
    stage: Stage, fault: str, late: int
) -> None:
    base_deg = stage.rsi.axes_deg[0]
    stage.inject(fault)
    angles = stage.move(2.0)
    assert stage.rsi.late == late
    assert largest_step(angles) < 0.3
    assert rests_at(stage, 2.0, base_deg)
    assert stage.rsi.late == late
    assert stage.eki.state(Id="8").get("RSI") == "2"


def test_replies_out_of_order_are_late_and_the_later_one_acts(stage: Stage) -> None:
    base_deg = stage.rsi.axes_deg[0]
    stage.inject("reorder 40 % for 0.8 s")
    angles = stage.move(2.0)
    assert 50 < stage.rsi.late < 110
    assert largest_step(angles) < 0.3
    assert rests_at(stage, 2.0, base_deg)


def test_lost_telegrams_are_gaps_in_the_stamps_and_late_cycles(stage: Stage) -> None:
    stage.inject("lose telegrams 30 % for 0.8 s")
    stamps = [stage.rsi.ipoc]
    for _ in range(200):
        stage.rsi.cycles(1)
        stamps.append(stage.rsi.ipoc)
    steps = [b - a for a, b in pairwise(stamps)]
    assert all(step % 4 == 0 and step > 0 for step in steps)
    lost = sum(step // 4 - 1 for step in steps)
    assert 30 < lost < 90
    assert stage.rsi.late == lost


def test_broken_telegrams_reach_the_client_and_their_cycles_are_late(stage: Stage) -> None:
    stage.inject("corrupt telegrams 30 % for 0.4 s")
    broken = 0
    for _ in range(100):
        if stage.rsi.receive_whole():
            stage.rsi.answer()
        else:
            broken += 1
    stage.rsi.cycles(50)
    assert 15 < broken < 50
    assert stage.rsi.late == broken


def test_after_a_short_cut_of_the_network_the_stream_goes_on(stage: Stage) -> None:
    base_deg, before = stage.rsi.axes_deg[0], stage.rsi.ipoc
    stage.rsi.cycles(100, on_a1(0.1))
    between = stage.rsi.ipoc
    stage.inject("network cut for 0.2 s")
    stage.rsi.cycles(1, on_a1(0.1))
    stage.rsi.cycles(5, on_a1(0.1))
    assert between - before == 400
    assert stage.rsi.late == pytest.approx(50, abs=1)
    assert stage.rsi.ipoc - between == pytest.approx(4 * (6 + 50), abs=8)
    assert stage.rsi.axes_deg[0] == pytest.approx(base_deg + 0.1, abs=1e-4)


def test_a_long_cut_of_the_network_ends_in_the_time_out(stage: Stage) -> None:
    stage.inject("network cut for 1 s")
    state = stage.eki.state(RSI="3")
    assert (state.get("Err"), state.get("ProState"), state.get("Drives")) == ("29002", "P_STOP", "1")
    assert stage.eki.command("RSI_START") == 1
    assert stage.eki.command("ACK_ERRORS") == 0


def test_a_foreign_sender_has_a_port_and_stamps_of_its_own(stage: Stage) -> None:
    ours = stage.rsi.source
    stage.inject("foreign sender for 0.1 s")
    sources = []
    for _ in range(80):
        stage.rsi.receive()
        sources.append(stage.rsi.source)
        if stage.rsi.source == ours:
            stage.rsi.answer()
    assert sources.count(ours) < 80
    assert {source[0] for source in sources} == {"127.0.0.1"}
    assert len(set(sources)) == 2
    assert stage.rsi.late == 0


def test_a_run_may_begin_with_a_nearly_empty_telegram(stage: Stage) -> None:
    stage.inject("short first telegram for 100 s", "program restart")
    source = stage.rsi.source
    stage.rsi.until_other_source(source)
    assert len(stage.rsi.last) < 100
    assert stage.rsi.last.startswith(b'<Rob Type="KUKA"><IPOC>')
    stage.rsi.answer()
    stage.rsi.cycles(5)
    assert len(stage.rsi.last) > 300


# -- the cell


STOPS = [
    ("emergency stop for 0.2 s", {"EStop": "1", "Drives": "0", "Err": "1"}, {"EStop": "0"}),
    ("guard open for 0.2 s", {"Guard": "1", "Drives": "0", "Err": "6"}, {"Guard": "0"}),
    ("mode T2 for 0.2 s", {"Mode": "T2", "Drives": "0", "Err": "0"}, {"Mode": "EXT"}),
    ("drives off", {"Drives": "0", "Err": "0"}, {}),
    ("collision", {"Drives": "0", "Err": "117"}, {}),
]


@pytest.mark.parametrize(("fault", "during", "after"), STOPS, ids=[stop[0] for stop in STOPS])
def test_a_stop_of_the_robot_is_told_by_eki_and_the_arm_stands_while_rsi_streams(
    stage: Stage, fault: str, during: dict[str, str], after: dict[str, str]
) -> None:
    stage.move(3.0, cycles=50)
    stage.inject(fault)
    stage.rsi.cycles(40, on_a1(3.5))
    stage.eki.until(lambda e: all(e.get(key) == value for key, value in during.items()))
    resting_deg = stage.rsi.axes_deg
    stage.rsi.cycles(40, on_a1(4.0))
    assert stage.rsi.axes_deg == resting_deg
    state = stage.eki.state(**after, RSI="1")
    assert state.get("ProState") == "P_STOP"
    assert stage.eki.command("RSI_START") == 4
    assert stage.eki.command("RSI_STOP") == 0
    assert stage.rsi.quiet(0.1)
    if during.get("Err", "0") != "0":
        assert stage.eki.command("RSI_START") == 1
        assert stage.eki.command("ACK_ERRORS") == 0
    assert stage.eki.command("RSI_START") == 5  # the drives are off
    assert stage.eki.command("DRIVES", On=1) == 0
    assert stage.eki.command("RSI_START") == 0


def test_while_the_emergency_stop_is_pressed_nothing_can_be_switched_on_or_acknowledged(
    stage: Stage,
) -> None:
    stage.inject("emergency stop")
    stage.rsi.cycles(5)
    assert stage.eki.command("DRIVES", On=1) == 5
    assert stage.eki.command("ACK_ERRORS") == 5
    status = stage.sdk().read().find("Status")
    assert status is not None
    told = ("DrivesPowered", "EmergencyStop", "GuardStop", "MotionPossible", "RobotStopped")
    assert [status.get(name) for name in told] == ["0", "1", "0", "0", "1"]


def test_in_T1_corrections_need_the_start_key_a_confirmation_and_the_enabling_switch(stage: Stage) -> None:
    assert stage.eki.command("RSI_STOP") == 0
    stage.inject("mode T1")
    stage.eki.state(Mode="T1", Moving="0")
    assert stage.eki.command("DRIVES", On=1) == 0
    assert stage.eki.command("RSI_START") == 1
    assert stage.eki.command("PTP_AXIS", A1=0, A2=-90, A3=90, A4=0, A5=80, A6=0) == 1
    stage.inject("mode T1", "start key held")
    stage.rsi.forget()
    stage.eki.until_command("RSI_START", 0)
    stage.rsi.cycles(20)
    assert stage.eki.state(Id="8").get("RSI") == "1"
    assert stage.eki.command("ACK_ERRORS") == 0
    stage.rsi.cycles(5)
    assert stage.eki.state(Id="8").get("RSI") == "2"
    stage.inject("mode T1", "start key held", "enabling switch released")
    stage.rsi.cycles(20)
    state = stage.eki.state(Drives="0")
    assert (state.get("Err"), state.get("RSI")) == ("26", "1")
    assert stage.eki.command("DRIVES", On=1) == 5


def test_in_T1_the_tool_is_stopped_above_250_mm_per_second(stage: Stage) -> None:
    assert stage.eki.command("RSI_STOP") == 0
    stage.inject("mode T1", "start key held")
    stage.eki.state(Mode="T1", Moving="0")
    stage.rsi.forget()
    assert stage.eki.command("DRIVES", On=1) == 0
    stage.eki.until_command("RSI_START", 0)
    stage.rsi.cycles(10)
    assert stage.eki.command("ACK_ERRORS") == 0
    stage.rsi.cycles(10)
    stage.move(3.0, cycles=300)  # a few mm/s
    stage.rsi.cycles(50, on_a1(3.0))
    assert stage.eki.state(Id="8").get("Err") == "0"
    for n in range(1, 200):  # a gentle start to 45 deg/s at more than 400 mm
        if not stage.rsi.try_cycle(on_a1(3.0 + 0.18 * n * min(1.0, n / 60))):
            break
    assert stage.eki.state(RSI="3").get("Err") == "421"


def test_an_overload_stop_is_not_told_and_the_measured_axes_stop_following(stage: Stage) -> None:
    base_deg = stage.rsi.axes_deg[0]
    stage.move(3.0)
    stage.rsi.cycles(60, on_a1(3.0))
    stage.inject("overload")
    stage.move(6.0, begin_deg=3.0)
    assert stage.rsi.axes_deg[0] == pytest.approx(base_deg + 3.0, abs=1e-4)
    state = stage.eki.state(Id="8")
    assert (state.get("RSI"), state.get("Err"), state.get("Drives")) == ("2", "0", "1")
    assert stage.eki.command("RSI_STOP") == 0
    stage.eki.state(RSI="0", Moving="0")
    stage.rsi.forget()
    assert stage.eki.command("RSI_START") == 0
    stage.rsi.cycles(10)
    stage.move(1.0)
    assert rests_at(stage, 1.0, base_deg + 3.0)


def test_a_sticking_axis_moves_by_fits_and_starts_and_lags_behind(stage: Stage) -> None:
    base_deg = stage.rsi.axes_deg[0]
    smooth = stage.move(1.0, cycles=500)
    stage.rsi.cycles(60, on_a1(1.0))
    stage.inject("stick axis 1 for 100 s")
    sticking = stage.move(2.0, cycles=500, begin_deg=1.0)
    assert sum(a == b for a, b in pairwise(sticking)) > 200
    assert sum(a == b for a, b in pairwise(smooth)) < 100
    stage.rsi.cycles(60, on_a1(2.02))
    behind_deg = base_deg + 2.02 - stage.rsi.axes_deg[0]
    assert 0.001 < abs(behind_deg) <= 0.051
    stage.world.set_fault_script("")
    assert rests_at(stage, 2.02, base_deg)


def test_a_restarted_program_has_another_port_other_stamps_and_the_present_pose_as_its_base(
    stage: Stage,
) -> None:
    base_deg, source, stamp = stage.rsi.axes_deg[0], stage.rsi.source, stage.rsi.ipoc
    stage.move(4.0, cycles=60)
    stage.inject("program restart")
    stage.rsi.until_other_source(source)
    assert abs(stage.rsi.ipoc - stamp) > 4 * 1000
    assert stage.rsi.late == 0
    reached_deg = stage.rsi.axes_deg[0]
    assert 3.0 < reached_deg - base_deg < 4.5
    stage.rsi.answer()
    stage.rsi.cycles(20)
    assert stage.rsi.axes_deg[0] == reached_deg


# -- EKI


def test_a_cut_of_eki_ends_the_conversation_and_not_the_run(stage: Stage) -> None:
    stage.inject("eki cut")
    stage.rsi.cycles(3)
    with pytest.raises(ConnectionError):
        stage.eki.until(lambda element: False)
    stage.rsi.cycles(20)
    assert stage.reconnect().state(Id="8").get("RSI") == "2"


def test_a_full_memory_ends_the_connection_with_the_next_request(stage: Stage) -> None:
    assert stage.eki.command("SET_OV", Val=100) == 0  # nothing asked before is still under way
    stage.inject("eki overflow")
    stage.rsi.cycles(30)
    assert stage.eki.read().tag == "State"  # it still tells its state
    stage.eki.socket.sendall(b'<Cmd Id="5" Name="SET_OV" Val="42"></Cmd>')
    with pytest.raises(ConnectionError):
        stage.eki.until(lambda element: False)
    assert stage.reconnect().state(Id="8").get("Ov") == "100"


def test_half_a_telegram_is_followed_by_whole_ones(stage: Stage) -> None:
    stage.inject("eki half telegram")
    stage.rsi.cycles(3)
    segments = stage.eki.raw(4)
    assert any(not text.rstrip().endswith(b"</State>") for text in segments)
    stage.world.set_fault_script("")
    assert stage.reconnect().state(Id="8").get("RSI") == "2"


def test_a_silent_eki_program_neither_tells_nor_answers_until_it_goes_on(stage: Stage) -> None:
    stage.inject("eki silence")
    stage.rsi.cycles(5)
    stage.eki.settle()
    stage.eki.socket.sendall(b'<Cmd Id="5" Name="STATUS"></Cmd>')
    stage.rsi.cycles(100)
    assert stage.eki.hears_nothing(0.15)
    stage.world.set_fault_script("")
    stage.rsi.cycles(3)
    assert stage.eki.until(lambda element: element.get("Id") == "5").get("RSI") == "2"


# -- variants, and live


def test_both_channels_tell_a_live_emergency_stop_as_their_next_word(
    new_cell: Callable[..., Cell],
) -> None:
    cell = new_cell()
    eki, sdk = cell.project(), cell.sdk()
    sdk.read()
    eki.read()
    ask_room(cell.child.ready["control"], {"do": "fault", "line": "now: robot emergency stop"})
    told = [eki.read().get("EStop") for _ in range(6)]
    # What was under way, what was due every 100 ms on a machine that stalls, and the change.
    assert "1" in told
    status = sdk.read().find("Status")
    assert status is not None
    assert status.get("EmergencyStop") == "1"


def test_a_controller_may_end_rsi_with_a_stop_and_fall_silent(
    world: World, new_cell: Callable[..., Cell]
) -> None:
    cell = new_cell("--set", "streams_after_stop=false", world=world)
    eki, rsi = cell.project(), cell.rsi
    cell.start(eki)
    rsi.cycles(20)
    world.set_fault_script(f"at {world.clock.now_s():.6f} s: robot emergency stop for 0.1 s")
    assert rsi.quiet(0.2)
    state = eki.state(RSI="3")
    assert (state.get("Err"), state.get("ProState")) == ("1", "P_STOP")
    world.clock.sleep(0.2)
    eki.state(EStop="0")
    assert eki.command("ACK_ERRORS") == 0


@pytest.fixture
def world() -> Iterator[World]:
    world = World.create(built_in_scene("mini", seed=5), paced=False)
    yield world
    world.clock.close()


@pytest.fixture
def new_cell() -> Iterator[Callable[..., Cell]]:
    with ExitStack() as stack:
        yield lambda *options, world=None: Cell(stack, *options, world=world)
