"""One robot controller for many tests of its faults, in lock-step, brought back to rest between them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from itertools import pairwise
from typing import Any

import pytest
from kuka_clients import Cell, EkiClient, RsiClient

from sim.world.scene.named_scenes import draw_scene
from sim.world.world import World

CYCLE_S = 0.004
LONGEST_TEST_S = 60.0  # theatre time that may pass at once: a controller at rest would run at 10 Hz
Make = Callable[..., Any]  # a fixture that makes something


class SharedController:
    """One controller for all tests, brought back to rest between them."""

    def __init__(self, stack: ExitStack) -> None:
        self.world = World.create(draw_scene("mini", seed=5), paced=False)
        self._cell = Cell(stack, world=self.world)
        self.rsi: RsiClient = self._cell.rsi
        self.eki: EkiClient = self._cell.project()

    def begin(self) -> None:
        """RSI streams, corrections act, nothing is wrong."""
        self.world.set_fault_script("")
        self.world.clock.let_pass(LONGEST_TEST_S)
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
        self.rsi.await_telegram()  # the controller has finished the last cycle, and waits for us in the next
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


def on_a1(value: float) -> tuple[float, ...]:
    return (value, 0.0, 0.0, 0.0, 0.0, 0.0)


def largest_step(angles: Sequence[float]) -> float:
    return max(abs(b - a) for a, b in pairwise(angles))


def rests_at(shared: SharedController, correction_deg: float, base_deg: float) -> bool:
    shared.rsi.cycles(100, on_a1(correction_deg))
    return shared.rsi.axes_deg[0] == pytest.approx(base_deg + correction_deg, abs=1e-4)
