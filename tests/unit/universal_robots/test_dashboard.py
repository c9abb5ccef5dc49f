"""Dashboard client: no line is taken for the answer to another question than its own."""

from __future__ import annotations

import select
from collections.abc import Iterator
from contextlib import closing

import pytest
from coded_errors import raises
from handmade_ur import HandmadeController

from drivers.universal_robots.dashboard import DashboardClient
from drivers.universal_robots.errors import BAD_BYTES, COMMAND_REFUSED, STREAM_ERRORS
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.wire.universal_robots import RobotMode, SafetyMode
from ronna_hw.wire.universal_robots_services import DashboardOrder, Query

LIMIT_S = 5.0
ANSWERS: dict[Query | DashboardOrder, str] = {
    Query.ROBOT_MODE: "Robotmode: RUNNING",
    Query.SAFETY_MODE: "Safetymode: NORMAL",
    Query.ROBOT_MODEL: "UR5",
    Query.SERIAL_NUMBER: "20265500001",
    Query.REMOTE_CONTROL: "true",
    Query.RUNNING: "Program running: false",
    Query.ADD_TO_LOG: "Added log message",
    DashboardOrder.POWER_ON: "Powering on",
    DashboardOrder.POWER_OFF: "Powering off",
    DashboardOrder.BRAKE_RELEASE: "Brake releasing",
    DashboardOrder.STOP: "Stopped",
    DashboardOrder.CLOSE_SAFETY_POPUP: "closing safety popup",
    DashboardOrder.UNLOCK_PROTECTIVE_STOP: "Protective stop releasing",
    DashboardOrder.RESTART_SAFETY: "Restarting safety",
}


@pytest.fixture
def controller() -> Iterator[HandmadeController]:
    with closing(HandmadeController()) as made:
        yield made


@pytest.fixture
def client(controller: HandmadeController) -> Iterator[DashboardClient]:
    endpoint = parse_endpoint(controller.endpoints["dashboard"])
    with closing(DashboardClient(endpoint.host, endpoint.port, LIMIT_S)) as made:
        yield made


def send_unasked(controller: HandmadeController, client: DashboardClient, line: str) -> None:
    """Send a line that nobody asked for, and return once it has arrived."""
    controller.dashboard_clients[-1].sendall(line.encode())
    assert select.select((client._socket,), (), (), LIMIT_S)[0]


@pytest.mark.parametrize("surplus", ["Safetymode: NORMAL\n", "Safetymode: NORMAL\nSafetymode: NOR"])
def test_a_line_that_came_before_the_question_is_not_its_answer(
    controller: HandmadeController, client: DashboardClient, surplus: str
) -> None:
    controller.answers["safetymode"] = "Safetymode: FAULT"
    send_unasked(controller, client, surplus)
    assert client.safety_mode(LIMIT_S) is SafetyMode.FAULT
    assert client.robot_mode(LIMIT_S) is RobotMode.RUNNING


@pytest.mark.parametrize("surplus", ["Safetymode: NORMAL", "Robotmode: RUNNING"])
def test_a_line_too_many_is_an_error_and_moves_no_later_answer(
    controller: HandmadeController, client: DashboardClient, surplus: str
) -> None:
    controller.answers["safetymode"] = f"{surplus}\nSafetymode: FAULT"
    with raises(BAD_BYTES, match="URD-016"):
        client.safety_mode(LIMIT_S)
    controller.answers["safetymode"] = "Safetymode: FAULT"
    assert client.safety_mode(LIMIT_S) is SafetyMode.FAULT
    assert client.is_remote(LIMIT_S)


@pytest.mark.parametrize("question", ANSWERS)
def test_the_answer_to_any_other_question_is_an_error(
    controller: HandmadeController, client: DashboardClient, question: Query | DashboardOrder
) -> None:
    for other, answer in ANSWERS.items():
        controller.answers[question] = answer
        if other is question:
            assert client.ask(question, LIMIT_S) == answer
        else:
            with raises(BAD_BYTES):
                client.ask(question, LIMIT_S)


def test_an_order_that_is_refused_in_other_words_is_no_mistake_of_the_line(
    controller: HandmadeController, client: DashboardClient
) -> None:
    controller.answers["power on"] = "Command is not allowed due to safety reasons"
    with raises(COMMAND_REFUSED):
        client.require(DashboardOrder.POWER_ON, LIMIT_S)
    assert len(controller.dashboard_clients) == 1


def test_a_late_answer_is_not_that_to_the_next_question(
    controller: HandmadeController, client: DashboardClient
) -> None:
    controller.answers["safetymode"] = None
    with raises(STREAM_ERRORS.no_answer):
        client.safety_mode(0.05)
    send_unasked(controller, client, "Safetymode: NORMAL\n")
    controller.answers["safetymode"] = "Safetymode: FAULT"
    assert client.safety_mode(LIMIT_S) is SafetyMode.FAULT


def test_a_connection_that_the_controller_closed_is_not_opened_again_on_its_own(
    controller: HandmadeController, client: DashboardClient
) -> None:
    # Perhaps another one answers there now: who recovers looks at its identity first.
    controller.dashboard_clients[-1].shutdown(2)
    for _ in range(2):
        with raises(STREAM_ERRORS.lost):
            client.safety_mode(LIMIT_S)
