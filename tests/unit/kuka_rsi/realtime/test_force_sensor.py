"""Force sensor on the flange of a KUKA arm: its signals in the base, and a sensor that says nothing."""

from __future__ import annotations

from math import hypot

import pytest
from rsi_stand import FAR, LIMITS, MODEL, SETTINGS, START, RsiStand

from drivers.kuka_rsi.options import KukaOptions
from drivers.kuka_rsi.realtime.session import FROZEN_CYCLES
from drivers.kuka_rsi.realtime.telegram import Telegram, TelegramReader, read_forces
from ronna_hw.arm.motion.planning import plan_joint_move
from ronna_hw.arm_stream.records import ForceLimit, MotionResult, Move, Orders
from ronna_hw.wire.kuka_context import context_hash, load_context

FORCES = ' Fx="{:.4f}" Fy="-2.0000" Fz="{:.4f}" Tx="0.0100" Ty="0.0000" Tz="-0.0200"'
LIMIT_N = 20.0


class SensingStand(RsiStand):
    """Arm whose sensor shows a force along its z axis, with a noise of a hundredth on x."""

    def __init__(self) -> None:
        self.force_N, self.is_alive = 0.0, True
        self._shown = FORCES.format(0.0, 0.0)
        super().__init__(force_filter_s=0.02, force_at_rest_N=15.0)

    def cycle(self, lost: int = 0) -> bool:
        if self.is_alive:
            self._shown = FORCES.format((self.ipoc % 7) / 100.0, self.force_N)
        session, answer = self.session, self.session.answer

        def with_forces(telegram: Telegram, orders: Orders, now_ns: int) -> bytes | None:
            return answer(telegram._replace(forces=self._shown.encode()), orders, now_ns)

        session.answer = with_forces  # type: ignore[method-assign]
        try:
            return super().cycle(lost)
        finally:
            session.answer = answer  # type: ignore[method-assign]

    def move(self) -> None:
        self.give(Move(plan_joint_move(MODEL, START, FAR, LIMITS), ForceLimit(LIMIT_N)))


def rested() -> SensingStand:
    stand = SensingStand()
    stand.cycles(200)
    return stand


def test_the_signals_of_a_sensor_are_read_in_a_telegram_that_has_them_and_left_out_of_one_that_has_not() -> (
    None
):
    context = load_context()
    reader = TelegramReader(tuple(one.tag for one in context.with_force_sensor().all_send))
    head = '<Rob Type="KUKA"><RIst X="0.0"/><AIPos A1="1.0" A2="2.0" A3="3.0" A4="4.0" A5="5.0" A6="6.0"/>'
    head += '<EIPos E1="0.0"/><Delay D="0"/>'
    forces = FORCES.format(0.5, -12.25)
    with_sensor, without = (
        reader.read(f"{head}{one}<IPOC>4</IPOC></Rob>".encode()) for one in (f"<FT{forces}/>", "")
    )
    assert read_forces(with_sensor.forces) == (0.5, -2.0, -12.25)
    assert read_forces(without.forces) is None
    assert with_sensor._replace(forces=b"") == without
    assert context_hash(context.with_force_sensor()) == context_hash(context)


def test_a_force_on_the_flange_is_stated_in_the_base() -> None:
    stand = rested()
    stand.force_N = 12.0
    stand.cycles(100)
    state = stand.session.state(real_time=False, locked=False)
    x, y, z = MODEL.forward(START).rotate((0.03, -2.0, 12.0))
    assert state.force_N == pytest.approx((x, y, z), abs=0.1)
    assert state.is_force_known


def test_a_force_stops_the_motion_whose_limit_it_exceeds() -> None:
    stand = rested()
    stand.move()
    stand.cycles(60)
    assert stand.session.moving
    stand.force_N = LIMIT_N + 2.0
    stand.run()
    assert stand.session.result is MotionResult.FORCE
    assert hypot(*stand.session.state(real_time=False, locked=False).force_N) > LIMIT_N


@pytest.mark.hazard(66)
def test_a_sensor_that_repeats_itself_stops_a_motion_and_starts_none() -> None:
    stand = rested()
    stand.move()
    stand.cycles(60)
    stand.is_alive = False
    stand.cycles(FROZEN_CYCLES + 2)
    assert not stand.session.state(real_time=False, locked=False).is_force_known
    stand.run()
    assert stand.session.result is MotionResult.FORCE
    stand.cycles(200)
    stand.give(Move(plan_joint_move(MODEL, stand.session.sent_rad, START, LIMITS), ForceLimit(LIMIT_N)))
    stand.cycles(3)
    assert stand.session.result is MotionResult.REFUSED_LOADED


def test_without_the_option_no_force_is_watched() -> None:
    assert KukaOptions().process_settings()["force_filter_s"] == 0.0
    assert KukaOptions(force_sensor=True).process_settings()["force_filter_s"] > 0.0
    assert SETTINGS.force_filter_s == 0.0
