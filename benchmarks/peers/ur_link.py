"""The Universal Robots driver's real-time process with an open stream.

Arguments: the controller's endpoint; rest, or move to be always in motion; ur5 for that arm, not a UR5e;
unrehearsed for a link that never rehearses its reply.
"""

from __future__ import annotations

import json
import os
import socket
import sys
from dataclasses import replace

from drivers.universal_robots.connections import PROCESS
from drivers.universal_robots.errors import STREAM_ERRORS
from drivers.universal_robots.options import UrOptions, link_settings
from drivers.universal_robots.realtime.loop import Handover
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.motion.planning import plan_joint_move
from ronna_hw.arm.universal_robots import UniversalRobot, universal_robot
from ronna_hw.arm_stream.client import LinkClient
from ronna_hw.arm_stream.records import LinkState, MotionResult, Move, OpenStream, StreamPhase
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.vectors import JointVector
from sim.world.process import end_with_parent

PATIENCE_S = 60.0  # between two blocks of packages this process is left alone
SWING_RAD = 0.6
FIRST_RECIPE, RUN = 1, 4711


def main() -> None:
    """Serve until terminated. The real-time process exits along with its parent."""
    end_with_parent(lambda: os._exit(0))
    options = UrOptions.model_validate({"model": "ur5" if "ur5" in sys.argv else "ur5e"})
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    settings = replace(
        link_settings(options, theirs.fileno()),
        silence_limit_s=PATIENCE_S,
        heartbeat_limit_s=PATIENCE_S,
        rehearsal_lead_us=0 if "unrehearsed" in sys.argv else options.rehearsal_lead_us,
    )
    link = LinkClient(settings, PROCESS, STREAM_ERRORS, inherited=(theirs.fileno(),))
    try:
        controller = parse_endpoint(sys.argv[1])
        with socket.create_connection((controller.host, controller.port)) as connection:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            Handover(FIRST_RECIPE, FIRST_RECIPE, RUN).give(ours, connection)
        model = universal_robot(options.model)
        limits = options.limits(settings.kinematics(), options.cycle_s)
        number = link.command(OpenStream(limits))
        link.wait(lambda state: state.command_number >= number, PATIENCE_S)
        print("READY " + json.dumps({"endpoint": sys.argv[1], "pid": link.process.pid}), flush=True)
        link.wait(lambda state: state.phase is StreamPhase.RUNNING, PATIENCE_S)
        if "move" in sys.argv:
            _swing(link, model, limits)
        while link.alive:
            link.wait(lambda state: state.phase is not StreamPhase.RUNNING, PATIENCE_S)
    finally:
        link.close()


def _swing(link: LinkClient, model: UniversalRobot, limits: MotionLimits) -> None:
    home = link.state.commanded_rad
    away: JointVector = (home[0] + SWING_RAD, *home[1:])
    while True:
        for target in (away, home):
            plan = plan_joint_move(model, link.state.commanded_rad, target, limits)
            number = link.command(Move(plan), link.stop_number)

            def has_ended(state: LinkState, number: int = number) -> bool:
                return state.command_number >= number and state.result is not MotionResult.RUNNING

            while link.wait(has_ended, PATIENCE_S) is None:
                pass


if __name__ == "__main__":
    main()
