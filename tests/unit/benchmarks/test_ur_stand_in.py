"""Programs that the benchmark of the Universal Robots link measures, against its stand-in of a controller."""

from __future__ import annotations

from benchmarks.robot.robot_cell import peer
from benchmarks.robot.ur_cell import ControllerStandIn

PATIENCE_S = 20.0  # for a reply, on a busy computer
CYCLES = 20
MOST_CYCLES = 5000  # until a motion has been planned and begun


def test_a_bare_client_answers_each_package() -> None:
    with ControllerStandIn(PATIENCE_S) as controller, peer("bare_rtde", controller.endpoint):
        for _ in range(CYCLES):
            controller.exchange()
    assert controller.moved_rad == 0.0


def test_the_driver_moves_the_arm_of_the_stand_in() -> None:
    with ControllerStandIn(PATIENCE_S) as controller, peer("ur_link", controller.endpoint, "move"):
        for _ in range(MOST_CYCLES):
            controller.exchange()
            if controller.moved_rad:
                return
    raise AssertionError("the arm of the stand-in does not move")
