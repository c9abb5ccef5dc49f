"""Step engine: journals the intent, does the work, then journals the result.

Work happens here, never in a transition of the state chart. Any early exit from a step stops the arm.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress

from procedures.engine.case import Case, StepKey, Stored
from procedures.engine.case_progress import CaseProgress, unusable_inputs
from procedures.engine.context import StepContext
from procedures.engine.device_faults import DeviceFaults
from procedures.engine.errors import TOOL_UNCHECKED, WRONG_RESULT
from procedures.engine.events import Advisory, CaseState, EventStream, Fault, Refusal, StepState
from procedures.engine.machine import ProcedureMachine
from procedures.engine.order import CaseOrder, Outcome
from procedures.engine.questions import Questions
from procedures.engine.run_folder import Recorder, close_run
from procedures.engine.setting import CaseSetting
from procedures.engine.states import RECOVERY
from procedures.journal.errors import JournalNotWritable, StepRefused
from procedures.journal.journal import Entry, Journal, JournalValue
from procedures.journal.results import StepResult
from procedures.operator.checkpoint import Checkpoint
from procedures.operator.errors import OperatorAborted
from procedures.operator.question import Question
from procedures.workcell.errors import WrongTool
from ronna_hw.errors import RonnaError
from ronna_hw.logs import logger
from ronna_hw.records import Record

TOUCHED = "the mounted tool may have been touched since it was checked"
_log = logger(part="engine")


class Engine:
    """Engine of one procedure run. After a failed step the case is held: the arm stops, results stay valid.

    `on_ending` is called before the arm is stopped for good; `before_result` returns data for each result.
    """

    def __init__(
        self,
        order: CaseOrder,
        case: Case,
        setting: CaseSetting,
        journal: Journal,
        *,
        events: EventStream | None = None,
        on_ending: Callable[[], None] = lambda: None,
        before_result: Callable[[], Mapping[str, JournalValue]] = dict,
        recorders: Sequence[Recorder] = (),
        recovering: bool = False,
        latest: StepKey | None = None,
    ) -> None:
        """Set up the run; `recorders` are closed with it, `recovering` starts in recovery (see `accept`).

        `latest` is the step that was done last, in a resumed run.
        """
        self.order = order
        self.case = case
        self.course = CaseProgress(order, case, latest)
        self.setting = setting
        self.events = EventStream(setting.clock.now_s) if events is None else events
        self.machine = ProcedureMachine(order, recovering=recovering)
        self.questions = Questions(setting, journal, self.events)
        self.checkpoint = Checkpoint(self.ask, self._resting, setting.clock)
        self.faults = DeviceFaults(self.course, setting.workcell, journal, self._recheck_tool)
        self._journal = journal
        self._redact = order.without_names
        self._on_ending = on_ending
        self._before_result = before_result
        self.recorders = list(recorders)
        self.running: StepKey | None = None
        self.compare_places = setting.workcell.compare_places  # before a step begins
        # Whether somebody elsewhere is to take a seat, order or answer, and nothing moves until then.
        self.is_awaiting_person: Callable[[], bool] = lambda: False
        # With the assistant's instrument in the guide: returns what nobody sees, refuses a way out beside it.
        self.look_before_retreat: Callable[[], str] = lambda: ""
        self.goes_on: Callable[[RonnaError], bool] = lambda _problem: False  # by somebody's consent
        for arm in setting.workcell.arms.values():
            arm.supervised.ask_before(self.checkpoint, self.questions.ask_in_time)

    @property
    def upcoming(self) -> StepKey | None:
        """The next step, or None if no step remains; see `CaseProgress.upcoming`."""
        return self.course.upcoming

    @property
    def instrument_in(self) -> str | None:
        """Trajectory on which an instrument is or may be beyond the entry, or None."""
        return self.setting.workcell.master.place.instrument_may_be_inside

    def why_refused(self, key: StepKey) -> tuple[str, ...]:
        """Return all reasons why a step cannot start now; empty if it can."""
        if self.machine.ended:
            return (f"the case has ended: {self.machine.state}",)
        if self.machine.state == RECOVERY:
            return ("the findings after the restart have not been accepted",)
        if faults := self.faults.descriptions:
            return tuple(faults.values())
        if unmet := self.course.why_not_now(key):
            return unmet
        spec = self.order.spec(key)
        return unusable_inputs(self.case, spec, key) or spec.preconditions(self.context(key))

    def run_step(self, key: StepKey) -> Record:
        """Run one step. Raises PRO-001 if it is refused; errors of the step propagate."""
        with suppress(RonnaError):  # an arm that reports no joints is where the journal has it
            self.compare_places()
        if unmet := self.why_refused(key):
            self._write(Entry.REFUSED, step=str(key), unmet=list(unmet))
            self.events.publish(Refusal(step=str(key), unmet=unmet))
            _log.warning("step refused", step=self._redact(str(key)), unmet=self._redact("; ".join(unmet)))
            raise StepRefused(f"{key} cannot start: {'; '.join(unmet)}", action=self._advice(key, unmet))
        spec = self.order.spec(key)
        self.machine.begin(key.name)
        self._show_state()
        self.running = key
        try:
            self._write(Entry.INTENT, step=str(key), moves=spec.moves_an_arm)
            self.events.publish(StepState(step=str(key), title=spec.title, state="begun"))
            _log.info("step begins", step=self._redact(str(key)))
            self.setting.room.announce(str(key))
            self.checkpoint.here(f"before {key}")
            context = self.context(key)
            outcome = spec.run(context)
            stored = self._store(key, outcome, context)
        except (KeyboardInterrupt, OperatorAborted) as ended:
            if isinstance(ended, KeyboardInterrupt):
                self._on_ending()
            self.setting.workcell.stop()
            self.machine.abort()
            self._show_state()
            with suppress(JournalNotWritable):  # an interruption takes precedence
                self._write(Entry.INTERRUPTED, step=str(key))
            self.events.publish(StepState(step=str(key), state="interrupted"))
            _log.warning("step interrupted", step=self._redact(str(key)))
            raise
        except Exception as problem:
            self._fail(key, self._journal.deletion or problem)
            self.require_record()  # its loss is the cause, whatever the step missed first
            raise
        finally:
            self.running = None
        self.course.latest = key
        for trajectory, reason in stored.result.leaves_out().items():
            self.find(f"{trajectory} was left out: {reason}")
        _log.info("step done", step=self._redact(str(key)), summary=self._redact(outcome.summary))
        self.events.publish(
            StepState(
                step=str(key),
                title=spec.title,
                state="done",
                summary=outcome.summary,
                record=stored.record.identifier,
            )
        )
        self._recheck_tool()
        self._finish_if_over()
        return stored.record

    def _advice(self, key: StepKey, unmet: tuple[str, ...]) -> str | None:
        """Return advice for a refused step, or None if the reasons already contain it."""
        if self.machine.ended:
            return "No further step is possible in this run."
        return self.course.advice_now(key) if unmet == self.course.why_not_now(key) else None

    def require_record(self) -> None:
        """Raise PRO-053 if the run's journal was deleted: nothing more may move."""
        if (deletion := self._journal.deletion) is not None:
            raise deletion

    @property
    def record_is_deleted(self) -> bool:
        return self._journal.deletion is not None

    @property
    def over(self) -> bool:
        """Whether no step remains and, in a case with targets, every arm is home."""
        leads = self.order.leads_to_targets
        return self.course.over and not (
            leads and (self.instrument_in or self.setting.workcell.is_any_arm_out)
        )

    def _finish_if_over(self) -> None:
        if self.over and not self.machine.ended:
            self.machine.finish()
            self._show_state()

    def run_to(self, last: StepKey | None = None) -> None:
        """Run upcoming steps until `last` is done or left out, or all of them if it is None."""
        while (key := self.upcoming) is not None:
            try:
                self.run_step(key)
            except RonnaError as problem:
                if not self.goes_on(problem):
                    raise
                key = last or key  # an order ends here: it did not mean the steps that follow now
            if key == last or (last is not None and self.course.is_settled(last)):
                return

    def context(self, key: StepKey) -> StepContext:
        return StepContext(
            key=key,
            reads=self.order.spec(key).reads,
            trajectories=self.order.trajectories,
            left_out=self.case.exclusions_before(key),
            setting=self.setting,
            _case=self.case,
            _questions=self.questions,
            _checkpoint=self.checkpoint,
            _events=self.events,
            _find=self.find,
            _void=self.void,
        )

    def ask(self, question: Question) -> str:
        """Ask the operator, record the answer and return its word."""
        return self.questions.ask(question).word

    def find(self, text: str, targets: Sequence[str] = (), **more: JournalValue) -> None:
        """Record a finding about `targets` for the operator without stopping the case."""
        if targets:
            more["targets"] = list(targets)
        self._write(Entry.FINDING, text=text, **more)
        self.events.publish(Advisory(text=text))
        _log.warning("finding", text=self._redact(text))

    def void(self, key: StepKey, reason: RonnaError) -> None:
        """Void a valid result and its descendants, except those of finished trajectories."""
        gone = [record.identifier for record in self.course.records_voided_by(key)]
        self._write(Entry.VOIDED, step=str(key), supersedes=gone, code=reason.code, what=str(reason))
        self.course.void(key)
        self._publish_superseded(key, gone, reason.summary)

    def doubt_tool(self, found: str) -> None:
        """Cast doubt on the tool check after a different tool was found.

        Raises PRO-027 in a step whose check this voids: the check must be repeated first.
        """
        standing = self.case.valid_results
        self.faults.doubt_tool(found)
        if self.running and self.case.valid_results != standing:
            raise TOOL_UNCHECKED(TOUCHED, got=found)

    def retreat_home(self) -> None:
        """Leave the head and park: have the instrument removed, withdraw the guide along its axis, go home.

        Raises PRO-001 for an arm in fault or before set-up, PRO-002 unless the operator confirms, PRO-004
        where they end the case on the way, and the errors of motions.
        """
        workcell = self.setting.workcell
        self.faults.require_arm_moves()
        self._write(Entry.HOME, instrument_in=self.instrument_in)
        try:
            _ = workcell.master.home_rad  # PRO-001 before set-up
            self.questions.rest_drill()
            for arm in workcell.outermost_first:
                if arm.leads_instrument:
                    arm.compare_place()
                if arm.leads_instrument:  # still: nobody has jogged it home
                    workcell.start()
                    arm.lead_out(self.look_before_retreat())
                self.questions.request_instrument_removal()
                arm.compare_place()
                if arm.place.is_out:
                    workcell.start()
                    arm.leave()
        except BaseException as ended:  # also an interruption: the arm comes to rest
            if isinstance(ended, KeyboardInterrupt):
                self._on_ending()
            workcell.stop()
            if isinstance(ended, OperatorAborted) and not self.machine.ended:
                self.abort()
            raise
        finally:
            self._forget_latest()
            if self.machine.state != RECOVERY and not self.machine.ended:
                self.machine.hold()
                self._show_state()
        self._recheck_tool()
        self._finish_if_over()

    def leave_head(self) -> None:
        """Retreat and park, unless the arm was never set up. Raises the same errors as `retreat_home`."""
        try:
            _ = self.setting.workcell.master.home_rad
        except StepRefused:
            return
        self.retreat_home()

    def _recheck_tool(self) -> None:
        """Void a doubtful tool check as soon as the tool is off the axis and no instrument is inside.

        Before that its result still serves the work at the target, and the way out.
        """
        in_use = self.setting.workcell.master.place.is_on_axis or self.instrument_in
        if in_use or self.machine.state == RECOVERY or self.machine.ended:
            return
        for key, fault in self.course.checks_in_doubt.items():
            self.void(key, TOOL_UNCHECKED(TOUCHED, got=fault))

    def _forget_latest(self) -> None:
        """Forget the latest step unless the step that must follow it can still run."""
        only = self.course.continuation
        if only is None or self.order.spec(only).preconditions(self.context(only)):
            self.course.latest = None

    def abort(self) -> None:
        """Abort the case between steps without motion. Raises PRO-001 if it has ended."""
        if self.machine.ended:
            raise StepRefused(f"the case has ended: {self.machine.state}", action="Leave with quit.")
        self.machine.abort()
        self._show_state()
        self._write(Entry.INTERRUPTED)
        _log.warning("case aborted")

    def record_seat(self, session: str, name: str, since_s: float | None) -> None:
        """Record the console operator's name and start time; an empty name frees the seat."""
        self._write(Entry.SEAT, session=session, by=name, since_s=since_s)

    def found(self, findings: Sequence[str], differences: Sequence[str] = ()) -> None:
        """Record the findings after a restart."""
        self._write(Entry.FOUND, findings=list(findings), differences=list(differences))

    def accept(self) -> None:
        """Leave recovery after the operator has accepted the findings, so that steps may begin."""
        self._write(Entry.ACCEPTED)
        self.machine.accept()
        self._forget_latest()
        self._show_state()
        self._recheck_tool()
        self._finish_if_over()

    @contextmanager
    def _resting(self, state: str, reason: str) -> Iterator[None]:
        """Keep the case paused or suspended during the block, even on the way home after its end."""
        try:
            with self.machine.resting(state), self.faults.require_no_acknowledgement():
                self._write(Entry.RESTED, state=state, reason=reason)
                self.events.publish(CaseState(state=state, reason=reason))
                yield
            self._write(Entry.RESUMED, state=state)
        finally:
            self._show_state()

    def _show_state(self, reason: str = "") -> None:
        self.events.publish(CaseState(state=self.machine.state, reason=reason))

    def close(self, outcome: str, problem: RonnaError | None = None) -> None:
        """Close connections and journal; `problem` is the error that ended the case, if any."""
        now_s = self.setting.clock.now_s()  # the clock ends with its theatre
        with suppress(JournalNotWritable):
            self.faults.doubt_results()
        self.events.hold_time()
        self.setting.workcell.close()
        for recorder in self.recorders:  # the journal's last line speaks for every file of the run
            recorder.close()
        more = {} if self.instrument_in is None else {"instrument_in": self.instrument_in}
        if problem is not None:
            more |= {"code": problem.code, "what": problem.what}
        try:
            close_run(self.case.folder, self._journal, now_s, outcome, self.setting.clinical, **more)
        finally:
            self.events.end()

    def _store(self, key: StepKey, outcome: Outcome[StepResult], context: StepContext) -> Stored[StepResult]:
        """Record, journal and accept a result, in that order; it becomes valid only once journalled."""
        expected = self.order.spec(key).result
        if type(outcome.result) is not expected:
            raise WRONG_RESULT(
                f"{key} returned a different result from the one it declares",
                expected=expected.__name__,
                got=type(outcome.result).__name__,
            )
        stored = self.case.store(key, outcome.result, context.read)
        gone = [record.identifier for record in self.course.records_superseded_by(key)]
        more: dict[str, JournalValue] = {"supersedes": gone} if gone else {}
        files = {"pictures": context.pictures, "inputs": context.inputs}
        more |= {name: hashes for name, hashes in files.items() if hashes}
        more |= self._before_result()
        self._write(
            Entry.RESULT, step=str(key), record=stored.record.identifier, sha256=stored.record.sha256, **more
        )
        self.course.accept(key, stored)
        self._publish_superseded(key, gone)
        return stored

    def _publish_superseded(self, key: StepKey, gone: Sequence[str], reason: str = "") -> None:
        for identifier in gone:
            self.events.publish(
                StepState(step=str(key), state="superseded", summary=reason, record=identifier)
            )

    def _fail(self, key: StepKey, problem: Exception) -> None:
        self.setting.workcell.stop()
        self.machine.hold()
        code = problem.code if isinstance(problem, RonnaError) else type(problem).__name__
        _log.error("step failed", step=self._redact(str(key)), error=code)  # its words are in the journal
        advice = problem.advice if isinstance(problem, RonnaError) else ""
        self.events.publish(Fault(code=code, what=str(problem), advice=advice))
        title = self.order.spec(key).title
        self.events.publish(StepState(step=str(key), title=title, state="failed", summary=str(problem)))
        self._show_state(str(problem))
        with suppress(JournalNotWritable):  # the step's own error is reported
            self.faults.doubt_results()
            if isinstance(problem, WrongTool):
                self.faults.doubt_tool(problem.summary)
        written_files = self._write_attachments(problem) if isinstance(problem, RonnaError) else []
        files: dict[str, JournalValue] = {"files": written_files} if written_files else {}
        with suppress(JournalNotWritable):
            self._write(Entry.FAILED, step=str(key), code=code, what=str(problem), **files)

    def _write_attachments(self, problem: RonnaError) -> list[JournalValue]:
        """Write the attachments of an error; return the names of the files written."""
        written_files: list[JournalValue] = []
        for name, text in sorted(problem.attachments.items()):
            try:
                (self.case.folder / name).write_text(text, encoding="utf-8")
                written_files.append(name)
            except OSError as error:  # such as a full disk: the error itself must be reported all the same
                _log.error("attachment not written", file=name, error=type(error).__name__)
        return written_files

    def _write(self, entry: Entry, **data: JournalValue) -> None:
        self._journal.write(entry, self.setting.clock.now_s(), **data)
