"""A controller without sockets and clock, and a client that writes its replies by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import pytest

from ronna_hw.wire.kuka_context import RsiContext, load_context
from sim.kuka.controller import Controller
from sim.kuka.controller_parameters import ControllerParameters
from sim.kuka.manipulator import Manipulator
from sim.world.scene.model import ArmTruth, LinkError
from sim.world.world import ArmState

HOME_DEG = (0.0, -90.0, 90.0, 0.0, 90.0, 0.0)
NO_ERROR = LinkError(translation_mm=(0.0, 0.0, 0.0), rotation_rad=(0.0, 0.0, 0.0))
ZERO6 = (0.0,) * 6


def _perfect_arm(**changes: Any) -> ArmTruth:
    """An arm whose true geometry is the nominal one, except for `changes`."""
    plain: dict[str, Any] = {
        "variant": "kr6_r900_sixx",
        "home_deg": HOME_DEG,
        "links": (NO_ERROR,) * 6,
        "joint_offset_rad": ZERO6,
        "harmonic_1_rad": ZERO6,
        "harmonic_1_phase_rad": ZERO6,
        "harmonic_2_rad": ZERO6,
        "harmonic_2_phase_rad": ZERO6,
        "sag_rad": (0.0, 0.0),
        "backlash_rad": ZERO6,
        "repeatability_mm": 0.0,
    }
    return ArmTruth(**{**plain, **changes})


def _context_with(**changes: dict[str, Any]) -> RsiContext:
    """Our own context with some fields of its tables changed."""
    content = load_context().model_dump(by_alias=True)
    for table, fields in changes.items():
        content[table] = {**(content[table] or {}), **fields} if fields is not None else None
    return RsiContext.model_validate(content)


@dataclass
class Bench:
    """A controller, what it published, and a client's hand."""

    controller: Controller
    published: list[ArmState] = field(default_factory=list)

    @property
    def A1_deg(self) -> float:
        return self.controller.arm.axes_deg[0]

    @property
    def message_number(self) -> int:
        assert self.controller.message is not None
        return int(self.controller.message.number)

    def telegram(self) -> bytes:
        run = self.controller.run
        assert run is not None
        return run.telegram(self.controller.arm.reported_frame, self.controller.arm.reported_deg)

    def answer(self, axes_deg: Sequence[float] = ZERO6, stop: int = 0) -> None:
        """One whole cycle with a reply."""
        run = self.controller.run
        assert run is not None
        attributes = " ".join(f'A{n}="{value:.6f}"' for n, value in enumerate(axes_deg, 1))
        data = f'<Sen Type="KROSHU"><Stop>{stop}</Stop><AK {attributes}/><IPOC>{run.ipoc}</IPOC></Sen>'
        reply = run.read(data.encode())
        assert reply is not None
        self.controller.finish_cycle(reply)

    def miss(self, cycles: int = 1) -> None:
        """Cycles without a reply."""
        for _ in range(cycles):
            self.controller.finish_cycle(None)

    def enter_movecorr(self) -> None:
        for _ in range(5):
            self.answer()

    def rest(self, axes_deg: Sequence[float] = ZERO6) -> None:
        """Hold a correction until the arm rests."""
        for _ in range(400):
            self.answer(axes_deg)
            if not self.controller.moving:
                return
        raise AssertionError("the arm does not come to rest")

    def ramp(self, to_deg: Sequence[float], from_deg: Sequence[float] = ZERO6, steps: int = 200) -> None:
        for n in range(1, steps + 1):
            share = n / steps
            self.answer([a + share * (b - a) for a, b in zip(from_deg, to_deg, strict=True)])

    def go(self, to_deg: Sequence[float], from_deg: Sequence[float] = ZERO6, steps: int = 200) -> None:
        """Ramp to a correction and hold it until the arm rests."""
        self.ramp(to_deg, from_deg, steps)
        self.rest(to_deg)


@pytest.fixture
def perfect_arm() -> Callable[..., ArmTruth]:
    return _perfect_arm


@pytest.fixture
def context_with() -> Callable[..., RsiContext]:
    return _context_with


@pytest.fixture
def make_bench() -> Callable[..., Bench]:
    def make(
        context: RsiContext | None = None,
        truth: ArmTruth | None = None,
        parameters: ControllerParameters | None = None,
        seed: int = 1,
        start: bool = True,
    ) -> Bench:
        published: list[ArmState] = []
        chosen = parameters or ControllerParameters()
        arm = Manipulator(truth or _perfect_arm(), seed, published.append, chosen)
        controller = Controller(context or load_context(), arm, lambda: 1, chosen)
        bench = Bench(controller, published)
        if start:
            controller.switch_drives(True)
            assert controller.start().code == 0
        return bench

    return make


@pytest.fixture
def bench(make_bench: Callable[..., Bench]) -> Bench:
    return make_bench()
