"""Every fault of the controller can be switched on live, at its control port, and is logged."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from importlib.resources import files
from pathlib import Path

import pytest
from kuka_clients import Cell, RsiClient

from ronna_hw.control_port import ask_control_port
from sim.world.faults import FaultKind
from sim.world.faults.robot import CELL_FAULTS, EKI_FAULTS, LINK_FAULTS
from sim.world.world import World

HANG_S = 60.0
NAMES = {"mode": "T2", "trip": "velocity"}


def line_of(kind: FaultKind) -> str:
    values = {"INT": "2", "NUMBER": "5", "NAME": NAMES.get(kind.name, "")}
    return " ".join(["robot", *(values.get(word, word) for word in kind.phrase.split())])


@pytest.fixture
def answered() -> Iterator[Callable[[RsiClient], None]]:
    """Answer every telegram of a client's, in a thread."""
    ending = threading.Event()
    threads: list[threading.Thread] = []

    def serve(rsi: RsiClient) -> None:
        while not ending.is_set():
            rsi.try_cycle((0.0,) * 6)

    def begin(rsi: RsiClient) -> None:
        threads.append(threading.Thread(target=serve, args=(rsi,)))
        threads[0].start()

    yield begin
    ending.set()
    for thread in threads:
        thread.join()


@pytest.fixture
def patient_context(tmp_path: Path) -> Path:
    """Our own, but a client that stalls with its machine does not end the run."""
    text = files("ronna_hw.wire").joinpath("kuka_rsi_context.toml").read_text("utf-8")
    path = tmp_path / "context.toml"
    path.write_text(text.replace("timeout_packets = 100", "timeout_packets = 1000000"))
    return path


def test_every_fault_can_be_switched_on_live_and_is_logged_with_its_telegram(
    cell: Callable[..., Cell], answered: Callable[[RsiClient], None], patient_context: Path
) -> None:
    here = cell("--autostart", "--rsi-context", str(patient_context))
    here.rsi.cycles(5)
    answered(here.rsi)
    control = here.child.ready["control"]
    # What ends the run comes last: a stopped program has no telegrams to log with.
    for kind in (*LINK_FAULTS, *EKI_FAULTS, *CELL_FAULTS):
        ask_control_port(control, "fault", line=f"now: {line_of(kind)}")
        wanted = f": {line_of(kind)}" + ("" if kind.momentary else " begins")
        deadline = time.monotonic() + HANG_S
        while not (logged := [line for line in here.child.messages if line.endswith(wanted)]):
            assert time.monotonic() < deadline, kind.name
            time.sleep(0.001)
        if kind not in CELL_FAULTS:
            assert ", IPOC " in logged[0]
        ask_control_port(control, "clear_faults")
    assert here.child.alive


def test_a_fault_begins_at_the_telegram_named_in_the_script(
    cell: Callable[..., Cell], lock_step_world: World
) -> None:
    lock_step_world.set_fault_script("at cycle 101: robot drop 100 % for 0.018 s")
    here = cell(world=lock_step_world)
    eki, rsi = here.project(), here.rsi
    here.start(eki)
    lock_step_world.clock.let_pass(1.0)
    late = []
    for _ in range(120):
        rsi.receive()
        late.append(rsi.late)
        rsi.answer()
    assert late[:101] == [0] * 101
    assert late[101:107] == [1, 2, 3, 4, 5, 5]
