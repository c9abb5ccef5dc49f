"""The driver's real-time process with an open session.

Arguments: rest, or move to be always in motion; busy for a main thread that is never idle; unrehearsed for a
link that never rehearses its reply.
"""

from __future__ import annotations

import json
import os
import sys
import threading

from drivers.kuka_rsi.connections import link_settings, start_link
from drivers.kuka_rsi.options import KukaOptions
from ronna_hw.arm.kr6_r900 import Kr6R900, kr6_r900
from ronna_hw.arm.motion.limits import MotionLimits, working_limits
from ronna_hw.arm.motion.planning import plan_joint_move
from ronna_hw.arm_stream.client import LinkClient
from ronna_hw.arm_stream.records import MotionResult, Move, OpenStream, StreamPhase
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.host.network import own_udp_endpoint
from ronna_hw.vectors import JointVector
from ronna_hw.wire.kuka_context import load_context
from sim.world.process import end_with_parent

PATIENCE_S = 60.0  # between two blocks of telegrams this process is left alone
SWING_RAD = 0.6


def main() -> None:
    """Serve until terminated. The real-time process exits along with its parent."""
    end_with_parent(lambda: os._exit(0))
    endpoint = own_udp_endpoint()
    options = KukaOptions.model_validate({"silence_limit_s": PATIENCE_S, "heartbeat_limit_s": PATIENCE_S})
    if "unrehearsed" in sys.argv:
        options = options.model_copy(update={"rehearsal_lead_us": 0})
    link = start_link(link_settings(parse_endpoint(endpoint), load_context(), options))
    try:
        model = kr6_r900(options.variant)
        limits = working_limits(model, options.speed_fraction)
        number = link.command(OpenStream(limits))
        link.wait(lambda state: state.command_number >= number, PATIENCE_S)
        print("READY " + json.dumps({"endpoint": endpoint, "pid": link.process.pid}), flush=True)
        link.wait(lambda state: state.phase is StreamPhase.RUNNING, PATIENCE_S)
        if sys.argv[1] == "move":
            if "busy" in sys.argv:
                threading.Thread(target=_swing, args=(link, model, limits), daemon=True).start()
                _never_rest()
            _swing(link, model, limits)
        while link.alive:
            link.wait(lambda state: state.phase is not StreamPhase.RUNNING, PATIENCE_S)
    finally:
        link.close()


def _never_rest() -> None:
    while True:
        sum(range(1000))


def _swing(link: LinkClient, model: Kr6R900, limits: MotionLimits) -> None:
    home = link.state.commanded_rad
    away: JointVector = (home[0] + SWING_RAD, *home[1:])
    while True:
        for target in (away, home):
            plan = plan_joint_move(model, link.state.commanded_rad, target, limits)
            number = link.command(Move(plan), link.stop_number)

            def has_ended(state: object, number: int = number) -> bool:
                return state.command_number >= number and state.result is not MotionResult.RUNNING  # type: ignore[attr-defined]

            while link.wait(has_ended, PATIENCE_S) is None:
                pass


if __name__ == "__main__":
    main()
