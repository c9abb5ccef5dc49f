"""Suite execution and reports."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any

from conformance.case import CaseOutcome, Nonconformity, NotShown, Suite, SuiteCase
from conformance.device_under_test import DeviceUnderTest
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.errors import RonnaError
from ronna_hw.records import canonical_json
from ronna_hw.text import printable

SCHEMA_VERSION = 1


@dataclass(frozen=True)
class CaseResult:
    """Result of one case; `reason` explains a failure or skip."""

    number: str
    statement: str
    needs: tuple[str, ...]
    outcome: CaseOutcome
    reason: str
    elapsed_s: float


@dataclass(frozen=True)
class Report:
    """Results of a suite run, with device and time."""

    suite: str
    driver: str
    endpoints: dict[str, str]
    identity: Identity
    started: str
    results: tuple[CaseResult, ...]
    confirmed_by: str = ""  # the person who stood by while the device was moved

    def count(self, outcome: CaseOutcome) -> int:
        return sum(result.outcome is outcome for result in self.results)

    @property
    def passed(self) -> bool:
        """Whether no case failed and at least one passed."""
        return self.count(CaseOutcome.FAIL) == 0 and self.count(CaseOutcome.PASS) > 0

    def as_document(self) -> dict[str, Any]:
        """Return the report as plain data with a SHA-256 hash of its contents."""
        document: dict[str, Any] = {
            "schema": SCHEMA_VERSION,
            "suite": self.suite,
            "driver": self.driver,
            "endpoints": self.endpoints,
            "identity": {**asdict(self.identity), "details": dict(self.identity.details)},
            "started": self.started,
            "confirmed_by": self.confirmed_by,
            "passed": self.passed,
            "summary": {outcome.value.lower(): self.count(outcome) for outcome in CaseOutcome},
            "cases": [{**asdict(result), "needs": list(result.needs)} for result in self.results],
        }
        return {**document, "sha256": hashlib.sha256(canonical_json(document)).hexdigest()}


def run_suite(
    suite: Suite,
    dut: DeviceUnderTest,
    progress: Callable[[float], None] = lambda share: None,
    *,
    confirmed_by: str = "",
) -> Report:
    """Run every case that the device under test permits, and skip the others.

    The device is connected once first; raises ConnectError and the like if that fails, because no case
    would be meaningful.
    """
    started = datetime.now(UTC).isoformat(timespec="seconds")
    device = dut.make()
    try:
        identity: Identity = device.connect()
        results = []
        for number, case in enumerate(suite.cases):
            results.append(run_case(case, dut))
            progress((number + 1) / len(suite.cases))
    finally:
        dut.release()
    config = dut.config
    endpoints = {"endpoint": config.endpoint} if config.endpoint is not None else dict(config.endpoints)
    return Report(suite.kind, config.driver, endpoints, identity, started, tuple(results), confirmed_by)


def run_case(case: SuiteCase, dut: DeviceUnderTest) -> CaseResult:
    """Run one case, or skip it with a reason; never raises.

    After a failure every connection is closed.
    """
    began_s = time.monotonic()
    needs = sorted(case.needs, key=lambda need: need.name)
    outcome, reason = CaseOutcome.PASS, ""
    if missing := [need.reason for need in needs if need.name not in dut.offers]:
        outcome, reason = CaseOutcome.SKIP, "; ".join(missing)
    else:
        try:
            case.run(dut)
        except NotShown as excuse:
            outcome, reason = CaseOutcome.SKIP, str(excuse)
        except (Nonconformity, RonnaError) as problem:
            outcome, reason = CaseOutcome.FAIL, str(problem)
        except Exception as problem:
            outcome, reason = CaseOutcome.FAIL, f"raised {problem!r}, which is not a RonnaError"
        if outcome is CaseOutcome.FAIL:
            dut.release()
    elapsed_s = round(time.monotonic() - began_s, 3)
    names = tuple(need.name for need in needs)
    reason = printable(" ".join(reason.split()))
    return CaseResult(case.number, case.statement, names, outcome, reason, elapsed_s)
