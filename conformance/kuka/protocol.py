"""Cases of the suite for KUKA controllers on RSI and EKI: stream, EKI, driver."""

from __future__ import annotations

from conformance.kuka import driver_cases, eki_cases, stream_cases
from conformance.kuka.checklist import KUKA_CHECKLIST
from conformance.protocol import ProtocolCases
from ronna_hw.host.loopback import own_udp_endpoint


def simulator() -> tuple[str, ...]:
    """Arguments of `ronna-sim` for a simulated controller; its client binds the RSI endpoint."""
    any_port = "tcp://127.0.0.1:0"
    return ("kuka", "--rsi", own_udp_endpoint(), "--eki", any_port, "--eki-project", any_port)


PROTOCOL = ProtocolCases(
    cases=(*stream_cases.CASES.cases, *eki_cases.CASES.cases, *driver_cases.CASES.cases),
    checklist=KUKA_CHECKLIST,
    simulator=simulator,
)
