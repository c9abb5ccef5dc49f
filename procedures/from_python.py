"""Simulated cases from Python: `run_case` runs one and returns its run, `compare_runs` compares two.

from procedures import run_case

run = run_case("mini", seed=7, arm="ur5e", faults="at 3 s: tracker occlude marker 2 for 2 s")
print(run.targets.error_mm)
"""

from __future__ import annotations

import hashlib
import os
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields, replace
from functools import cache, wraps
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar, get_args, get_type_hints

from procedures.operator.errors import NotConfirmed
from procedures.operator.question import Answer, Question, join_answers
from procedures.runs.answers import ScriptedOperator
from procedures.runs.observers import RunObservers
from ronna_hw.arguments import WrongArgument, require_path, show
from ronna_hw.command_line.messages import wants_plain_text
from ronna_hw.errors import RonnaError
from ronna_hw.loaded_run import LoadedRun, load_run
from ronna_hw.mistakes import describe_mistake
from ronna_hw.near_names import find_near
from ronna_hw.records import write_atomically

if TYPE_CHECKING:
    from rich.progress import Progress

    from procedures.engine.engine import Engine
    from procedures.engine.events import Event
    from procedures.reporting.comparison.page import RunComparison
    from procedures.runs.request import RunRequest

Decide = Callable[[Question], str | None]
THREADS = "OPENBLAS_NUM_THREADS"
A_QUESTION = (None,)  # one argument
DECIDES = "a function of a Question that returns one of its answers, or None"
FAULTS = 'one line or several, such as "at 3 s: tracker occlude marker 2 for 2 s"'
OPTIONS = 'options by name, such as {"markers": 4}'
# Options of the command for people or devices.
NOT_OPTIONS = {"sim", "config", "case", "out", "ask", "answers", "faults"}


Given = ParamSpec("Given")
Result = TypeVar("Result")


def _with_known_arguments(function: Callable[Given, Result]) -> Callable[Given, Result]:
    """Raise ARG-001 for arguments that a function does not take, and say where an option goes."""
    taken = signature(function)

    @wraps(function)
    def call(*args: Given.args, **kwargs: Given.kwargs) -> Result:
        try:
            taken.bind(*args, **kwargs)
        except TypeError as error:
            raise _explain_arguments(error, kwargs, list(taken.parameters)) from None
        return function(*args, **kwargs)

    return call


def _explain_arguments(error: TypeError, given: Mapping[str, object], taken: Sequence[str]) -> WrongArgument:
    expected = f"the arguments {', '.join(taken)}"
    unknown = next((name for name in given if name not in taken), None)
    if unknown is None:
        return WrongArgument(
            f"run_case cannot be called: {error}",
            expected=expected,
            action="Give scene and seed as they are, everything else by name.",
        )
    action = f'Options of the command go into options={{"{unknown}": {show(given[unknown])}}}.'
    if unknown not in _list_options():
        alike = find_near(unknown, [*taken, *_list_options()])
        action = f"Did you mean {alike[0]}?" if alike else "Further options of the command go into options=."
    return WrongArgument(f"run_case has no argument {unknown}", expected=expected, action=action)


@_with_known_arguments
def run_case(
    scene: str = "default",
    seed: int = 0,
    *,
    strategy: str = "ocs",
    arm: str = "kr6",
    dual: bool = False,
    faults: str | Sequence[str] = (),
    answers: Decide | None = None,
    out: str | os.PathLike[str] = "runs",
    progress: bool = True,
    options: Mapping[str, object] | None = None,
) -> LoadedRun:
    """Run a simulated case to its end, as `ronna-procedure run --sim`, and return its run.

    `faults` are one line of a fault script, or several. `answers` is called with each `Question` and returns
    one of its `answers`, or None for that of the script, the first. `options` are further ones of the
    command, with underscores, such as `{"markers": 4, "calibrated": True}`. `progress` shows a bar of the
    steps, in a notebook too.

    Raises ARG-001 for an unknown argument or option, a value of another type or out of its range, or an
    answer that a question does not accept, PRO-002 for an answer that does not go on, CLI-001 for options
    that exclude each other, and the error of a case that does not come to its end, with a note that names
    its run.
    """
    from procedures.runs.case_outcome import run_case as run_to_end
    from procedures.runs.finishing import finalize_run
    from procedures.runs.folders import hold_run, run_folder
    from procedures.runs.request_checks import check_case

    runs = require_path(out, "the folder of runs")
    given = {"scene": scene, "seed": seed, "strategy": strategy, "arm": arm, "dual": dual}
    _warn_of_threads()
    request, lines = _read_arguments(given, faults, answers, options)
    with _fault_script(lines, runs) as script, _step_bar(shown=progress) as follow:
        request = replace(request, faults=script)
        check_case(request, runs)
        operator = FunctionOperator(answers)
        observers = RunObservers(opened=follow, script=operator)
        with run_folder(request, runs) as folder, hold_run(folder):
            try:
                with finalize_run(folder, with_truth=False, name_report=False):
                    run_to_end(request, folder, observers)
            except RonnaError as error:
                told = operator.explain(error)
                if folder.exists():  # not of a case refused before it began
                    told.run = folder
                    told.add_note(f"its run is {folder}")
                raise told from error.__cause__
            except Exception as error:  # of the function that answers, whatever it is
                error.add_note(f"its run is {folder}")
                raise
            return load_run(folder)


def check_run_case(**arguments: Any) -> None:
    """Check arguments of `run_case` as it does, without running anything. Raises as it does."""
    from procedures.runs.request_checks import check_case

    taken = signature(run_case).bind(**arguments)
    taken.apply_defaults()
    given = taken.arguments
    choice = {name: given[name] for name in ("scene", "seed", "strategy", "arm", "dual")}
    request, _ = _read_arguments(choice, given["faults"], given["answers"], given["options"])
    check_case(request, require_path(given["out"], "the folder of runs"))


def _read_arguments(
    arguments: Mapping[str, object], faults: object, answers: object, options: object
) -> tuple[RunRequest, list[str]]:
    """Return the request and the lines of its fault script. Raises ARG-001, CLI-001."""
    _check_answers(answers)
    further = {} if options is None else options
    if not isinstance(further, Mapping):
        raise WrongArgument("options of run_case is no mapping", expected=OPTIONS, got=show(options))
    if twice := [name for name in further if name in arguments]:
        raise WrongArgument(
            f"options of run_case has {twice[0]}, which is an argument",
            action=f"Give it as one: {twice[0]}={show(further[twice[0]])}.",
        )
    return _make_request({**arguments, **further}), _list_faults(faults)


def compare_runs(
    first: LoadedRun | str | os.PathLike[str], second: LoadedRun | str | os.PathLike[str]
) -> RunComparison:
    """Compare two runs, as `ronna-procedure compare`: loaded ones or their folders. Both are only read.

    Damaged files never raise errors; what cannot be relied on is named. Raises CLI-005 for a folder that is
    no run, or for one run twice, ARG-001 for what is no path.
    """
    from procedures.reporting.comparison import page
    from procedures.runs.folders import require_two_runs

    folders = [require_path(getattr(one, "path", one), "the folder of a run") for one in (first, second)]
    require_two_runs(*folders)
    return page.compare_runs(*folders)


def _check_answers(answers: object) -> None:
    """Raise ARG-001 for anything but None or a function of one question."""
    if answers is None:
        return
    try:
        if callable(answers):
            signature(answers).bind(*A_QUESTION)
            return
    except (TypeError, ValueError) as error:
        got = f"a function that cannot be called with one: {error}"
    else:
        got = show(answers)
    raise WrongArgument("answers of run_case is no function of a question", expected=DECIDES, got=got)


def _list_faults(given: object) -> list[str]:
    """Return the lines of a fault script. Raises ARG-001 for anything else."""
    lines = [given] if isinstance(given, str) else given
    if isinstance(lines, Sequence) and all(isinstance(line, str) for line in lines):
        return list(lines)
    raise WrongArgument("faults of run_case are no lines of a fault script", expected=FAULTS, got=show(given))


@contextmanager
def _fault_script(lines: Sequence[str], runs: Path) -> Iterator[Path | None]:
    """Write a fault script beside the runs, where each run that names it finds it again.

    It is removed if the case is refused before it has a run.
    """
    if not lines:
        yield None
        return
    content = ("\n".join(lines) + "\n").encode()
    script = runs / f"faults-{hashlib.sha256(content).hexdigest()[:8]}.txt"
    is_new, is_new_folder = not script.exists(), not runs.exists()
    runs.mkdir(parents=True, exist_ok=True)
    write_atomically(script, content)
    try:
        yield script
    except RonnaError as error:
        if is_new and error.run is None:
            script.unlink(missing_ok=True)
            if is_new_folder:
                with suppress(OSError):  # another case has begun there
                    runs.rmdir()
        raise


@cache
def _warn_of_threads() -> None:
    """Warn once if linear algebra runs in several threads, which commands and `procedures` limit to one."""
    if os.environ.get(THREADS) == "1":
        return
    warnings.warn(
        f"NumPy was loaded with several threads: the last digits may differ from those of the command. "
        f"Set {THREADS}=1 before Python starts.",
        RuntimeWarning,
        stacklevel=4,  # who called `run_case`
    )


def _make_request(given: Mapping[str, object]) -> RunRequest:
    """Return the request for options of the command by name. Raises ARG-001, CLI-001."""
    from pydantic import TypeAdapter, ValidationError

    from procedures.cli.case.options import CaseOptions

    known = _list_options()
    for name in given:
        if name not in known:
            alike = find_near(name, known)
            raise WrongArgument(
                f"run_case has no option {show(name)}",
                action=f"Did you mean {alike[0]}?" if alike else f"There are {', '.join(sorted(known))}.",
            )
    _check_types(CaseOptions, given)
    try:
        options = TypeAdapter(CaseOptions).validate_python({"sim": True, **given})
    except ValidationError as error:
        first = error.errors()[0]
        name = str(first["loc"][0])
        expected = describe_mistake(first).removeprefix("expected ")
        raise WrongArgument(f"{name} of run_case", expected=expected, got=show(given[name])) from error
    _check_ranges(options)
    return options.request()


def _list_options() -> set[str]:
    """Return the names of the options that `run_case` accepts, those of its own arguments among them."""
    from procedures.cli.case.options import CaseOptions

    return {field.name for field in fields(CaseOptions)} - NOT_OPTIONS


def _check_types(options: type, given: Mapping[str, object]) -> None:
    """Raise ARG-001 for text or a truth value instead of a number, and for what is none where one is due.

    From the command line all of them come as text, so pydantic converts it.
    """
    hints = get_type_hints(options)
    for name, value in given.items():
        kinds = set(get_args(hints[name]) or (hints[name],))
        if kinds & {int, float} and isinstance(value, str | bool):
            expected = "a number" if float in kinds else "a whole number"
            raise WrongArgument(f"{name} of run_case", expected=expected, got=show(value))
        if bool in kinds and not isinstance(value, bool):
            raise WrongArgument(f"{name} of run_case", expected="True or False", got=show(value))


def _check_ranges(options: Any) -> None:
    """Raise ARG-001 for a number outside of the range that the command states for it."""
    for name, hint in get_type_hints(type(options), include_extras=True).items():
        value = getattr(options, name)
        for stated in getattr(hint, "__metadata__", ()):
            low, high = getattr(stated, "min", None), getattr(stated, "max", None)
            too_small = None not in (value, low) and value < low
            too_large = None not in (value, high) and value > high
            if too_small or too_large:
                raise WrongArgument(
                    f"{name} of run_case is out of range", expected=f"{low} to {high}", got=show(value)
                )


class FunctionOperator:
    """Operator backed by a function; for None, the script answers."""

    def __init__(self, decide: Decide | None) -> None:
        self._decide, self._script = decide, ScriptedOperator()
        self._last: tuple[Question, str] | None = None

    def ask(self, question: Question) -> Answer:
        """Return the function's answer. Raises ARG-001 for one that the question does not accept."""
        try:
            word = None if self._decide is None else self._decide(question)
        except Exception as error:
            error.add_note(f"raised by the function of answers= at the question {question.name}")
            raise
        if isinstance(word, str):
            word = word.casefold()
        self._last = None if word is None else (question, word)
        if word is None:
            return self._script.ask(question)
        if word not in question.answers:
            raise WrongArgument(
                f"answers of run_case returned no answer to {question.name}",
                expected=join_answers(question.answers),
                got=show(word),
                action="Return one of the question's answers, or None for its first.",
            )
        return replace(self._script.ask(question), word=word)

    def explain(self, error: RonnaError) -> RonnaError:
        """Return the error, which for an answer of the function says that it was its answer."""
        if self._last is None or not isinstance(error, NotConfirmed):
            return error
        question, word = self._last
        return error.reworded(
            error.what,
            expected=error.expected,
            got=error.got,
            action=f"The function of answers= returned {show(word)} to {question.name}; to go on, it returns "
            "None.",
        )


@contextmanager
def _step_bar(*, shown: bool) -> Iterator[Callable[[Engine], None]]:
    """Show a bar of the steps of a case; yields a function that follows an engine."""
    if not shown or wants_plain_text():
        yield lambda _engine: None
        return
    from rich.console import Console
    from rich.progress import Progress

    from procedures.cli.case.event_follower import EventFollower

    followers: list[EventFollower] = []
    with Progress(console=Console(stderr=True), transient=True) as progress:

        def follow(engine: Engine) -> None:
            followers.append(EventFollower(engine.events, _StepBar(progress, len(engine.order.sequence))))

        try:
            yield follow
        finally:
            for follower in followers:
                follower.join()


class _StepBar:
    """Progress bar of the steps of a case."""

    def __init__(self, progress: Progress, steps: int) -> None:
        self._progress = progress
        self._task = progress.add_task("", total=steps)

    def __call__(self, events: Sequence[Event]) -> None:
        """Advance the bar by these events."""
        from procedures.engine.events import StepState

        for event in events:
            match event.what:
                case StepState(state="begun", step=step):
                    self._progress.update(self._task, description=step)
                case StepState(state="done"):
                    self._progress.advance(self._task)
                case _:
                    pass
