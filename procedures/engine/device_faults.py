"""Device faults: description, acknowledgement by a person, and recovery."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from typing import TYPE_CHECKING

from procedures.engine.case import StepKey
from procedures.engine.case_progress import CaseProgress
from procedures.journal.errors import StepRefused
from procedures.journal.journal import Entry, Journal
from ronna_hw.devices.capabilities import MESSAGES
from ronna_hw.devices.errors import WrongState
from ronna_hw.devices.lifecycle import LastKnown, Lifecycle, require_person
from ronna_hw.logs import logger

if TYPE_CHECKING:
    from procedures.workcell import Workcell
    from procedures.workcell.device_views import DeviceView
    from ronna_hw.devices.capabilities import Fact
    from ronna_hw.errors import RonnaError

ACKNOWLEDGE = "acknowledge the fault by name: acknowledge YOUR-NAME"
UNKNOWN = "a fault of unknown cause"
EARLIER = "a message from before this connection"
_log = logger(part="engine")


def describe_fault(role: str, observed: LastKnown[object]) -> str:
    """Describe a faulted device's current state, with advice.

    Its cause is reported even if it is in order again, so that nobody searches for it in vain.
    """
    if observed.fault is None:
        return summarize_fault(role, observed)
    facts = _facts(observed.fault, observed.says)
    first = [fact.advice for fact in facts if not fact.ready and fact.name != MESSAGES]
    next_action = " ".join((*first, f"Then {ACKNOWLEDGE}")) if first else f"To continue, {ACKNOWLEDGE}"
    return f"{summarize_fault(role, observed)}. {next_action}"


def summarize_fault(role: str, observed: LastKnown[object]) -> str:
    """Describe a faulted device's current state, without advice."""
    if observed.fault is None:
        return f"the {role} is in fault"
    facts = _facts(observed.fault, observed.says)
    now = "; ".join(f"{fact.name}: {fact.found}" for fact in facts) or observed.fault.summary
    return f"the {role} is in fault ({observed.fault.code}), {now}"


def _cause_of(observed: LastKnown[object]) -> str:
    """Return the cause of the fault without advice, for permanent records."""
    return UNKNOWN if observed.fault is None else f"{observed.fault.code}: {observed.fault.summary}"


def _facts(fault: RonnaError, says: Sequence[Fact]) -> list[Fact]:
    """Return the facts that currently block the device or caused the fault."""
    return [fact for fact in says if not fact.ready or (fact.advice and fact.name in fault.what)]


def recover_faults(
    devices: Mapping[str, DeviceView], recover: Callable[[str], None]
) -> Iterator[tuple[str, str]]:
    """Recover each device that is in fault or still reports a message from an earlier connection.

    Yields its role and the acknowledged fault. Raises the errors of `recover`, which is called with the role.
    """
    for role, device in devices.items():
        observed = device.observe()
        if observed.state is Lifecycle.FAULT:
            recover(role)
            yield role, _cause_of(observed)
        elif observed.state is Lifecycle.CONNECTED:
            try:
                recover(role)
            except WrongState:  # it holds none
                continue
            messages = [fact.found for fact in observed.says if fact.name == MESSAGES and not fact.ready]
            yield role, f"{EARLIER} ({'; '.join(messages)})" if messages else EARLIER


class DeviceFaults:
    """Device faults of a case and the results they put in doubt."""

    def __init__(
        self,
        course: CaseProgress,
        workcell: Workcell,
        journal: Journal,
        on_doubt: Callable[[], None] = lambda: None,
    ) -> None:
        """Set up fault handling; `on_doubt` is called when a result is put in doubt."""
        self._on_doubt = on_doubt
        self._course = course
        self._workcell = workcell
        self._journal = journal
        self._acknowledged: list[tuple[str, str]] = []  # code of each fault, and by whom

    @property
    def now(self) -> dict[str, str]:
        return self._describe_each(lambda _role, observed: _cause_of(observed))

    @property
    def descriptions(self) -> dict[str, str]:
        """Descriptions of current faults, with advice, by device role."""
        return self._describe_each(describe_fault)

    @property
    def summaries(self) -> dict[str, str]:
        """Descriptions of current faults, without advice, by device role."""
        return self._describe_each(summarize_fault)

    def _describe_each(self, describe: Callable[[str, LastKnown[object]], str]) -> dict[str, str]:
        observed = {role: device.observe() for role, device in self._workcell.devices.items()}
        return {role: describe(role, one) for role, one in observed.items() if one.state is Lifecycle.FAULT}

    def require_arm_moves(self) -> None:
        """Raise PRO-001 with a fault description if an arm is in fault: of two, neither moves then."""
        found = self.descriptions
        if faults := [found[arm.name] for arm in self._workcell.arms.values() if arm.name in found]:
            raise StepRefused(f"the arm cannot move: {'. '.join(faults)}", action="Then repeat the command.")

    def acknowledge(self, by: str) -> dict[str, str]:
        """Recover every device in fault without motion; return the acknowledged faults by role.

        `by` is the person's name. Raises DEV-006, and the error of a driver that cannot be recovered yet.
        """
        require_person(by)
        workcell, done = self._workcell, dict[str, str]()
        self.doubt_results()
        for role, fault in recover_faults(workcell.devices, lambda role: workcell.recover(role, by)):
            # First: the device is recovered even if this cannot be written.
            self._acknowledged.append((fault.partition(": ")[0], by))
            self._doubt_after(role, fault)
            self._journal.write(
                Entry.ACKNOWLEDGED, self._workcell.clock.now_s(), device=role, fault=fault, by=by
            )
            _log.info("fault acknowledged", device=role)
            done[role] = fault
        workcell.release_halt(by)
        return done

    @contextmanager
    def require_no_acknowledgement(self) -> Iterator[None]:
        """Refuse to continue the step if a fault was acknowledged during the block.

        Raises PRO-001 at its end: only at its beginning does a step ask which results are kept and which tool
        is mounted.
        """
        before = len(self._acknowledged)
        yield
        if len(self._acknowledged) != before:
            raise StepRefused("a fault was acknowledged during the pause", action="Repeat what was paused.")

    @property
    def acknowledgements(self) -> int:
        return len(self._acknowledged)

    def as_of_now(self, problem: RonnaError, before: int) -> RonnaError:
        """Return a step's error for the end of the run, marked as settled if its fault was acknowledged.

        `before` is the number of acknowledgements when the step ended.
        """
        if self.now:
            return problem
        for code, by in reversed(self._acknowledged[before:]):
            if code and (code == problem.code or f"is in fault ({code})" in problem.what):
                settled_problem = copy(problem)
                settled_problem.what = f"was: {problem.what.rstrip('.')}; acknowledged by {by}"
                return settled_problem
        return problem

    def doubt_results(self) -> None:
        """After an arm fault, cast doubt on earlier localizations, tool checks, and bases of two arms.

        The journal has this before the fault can end, so that no restart loses it.
        """
        for role, fault in self.now.items():
            since = f" (theatre time {self._workcell.clock.now_s():.0f} s)"
            self._doubt_after(role, f"{fault}{self._why_stopped(role)}{since}")

    def _why_stopped(self, role: str) -> str:
        """Say what an arm was stopped for by the other one, or return ''."""
        halt, arm = self._workcell.halt, self._workcell.arm_of_device(role)
        stopped_by_other = halt is not None and arm is not None and halt.arm != arm.role
        return f", since {halt.reason}" if halt is not None and stopped_by_other else ""

    def _doubt_after(self, role: str, fault: str) -> None:
        order, arm = self._course.order, self._workcell.arm_of_device(role)
        if arm is None:
            return
        # It may have touched something. Tools and localizations are of the arm that carries the tools.
        carried = (*order.localizations, *order.checks_of_tool) if arm is self._workcell.master else ()
        self._doubt(fault, (*carried, *order.relations_of_arms))

    def doubt_tool(self, fault: str) -> None:
        """Cast doubt on all checks of the mounted tool."""
        self._doubt(fault, self._course.order.checks_of_tool)

    def _doubt(self, fault: str, steps: Sequence[StepKey]) -> None:
        case = self._course.case
        if keys := [key for key in steps if case.trusts(key)]:
            self._journal.write(
                Entry.DOUBTED, self._workcell.clock.now_s(), steps=list(map(str, keys)), fault=fault
            )
            for key in keys:
                case.doubt(key, fault)
            self._on_doubt()
