"""Sets up the device under test: starts our simulator if requested, and cleans up everything afterwards."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from ronna_hw.clock import open_clock
from ronna_hw.conformance.choice import Target, configured
from ronna_hw.conformance.device_under_test import DeviceUnderTest
from ronna_hw.host.child_process import ChildProcess, command

SIMULATOR_MODULE = "sim.cli"  # started as a command, never imported


@contextmanager
def stand(target: Target) -> Iterator[DeviceUnderTest]:
    """The device under test; whatever was started for it is ended on leaving. Raises PRC-001."""
    with ExitStack() as stack:
        config = target.config
        if config is None:
            assert target.protocol.simulator is not None, "resolve has checked that there is a simulator"
            arguments = target.protocol.simulator()
            child = stack.enter_context(
                ChildProcess(f"ronna-sim {arguments[0]}", command(SIMULATOR_MODULE, *arguments))
            )
            config = configured(
                target.driver, child.ready.get("endpoints") or {None: child.ready["endpoint"]}
            )
        dut = DeviceUnderTest(
            target.name,
            config,
            open_clock(target.clock),
            target.allowed,
            protocol=target.protocol,
            clock_known=target.clock_known,
        )
        stack.callback(dut.release)
        yield dut
