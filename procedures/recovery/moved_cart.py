"""After the cart or the tracker has moved: the case continues if the operator agrees."""

from __future__ import annotations

from procedures.engine.engine import Engine
from procedures.guards.errors import BaseShifted
from procedures.steps.branches import CART_MOVED, GO_ON
from procedures.steps.clinical.work_progress import work_begun_elsewhere
from ronna_hw.errors import RonnaError

MOST_MOVES = 3  # per program of a run: a cart that keeps moving needs another lock, not another localization


class MovedCart:
    """Asks, and brings the arm home; counts how often that was necessary."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._moves = 0

    def agreed_to_go_on(self, problem: RonnaError) -> bool:
        """Whether a case stopped by this problem continues on its own. Raises the errors of the way home."""
        engine = self._engine
        if not isinstance(problem, BaseShifted) or self._moves == MOST_MOVES or engine.machine.ended:
            return False
        self._moves += 1
        if (following := engine.upcoming) is None:
            goes_on = "lock it; the work at every target is done: the arm goes home and the case ends"
        else:
            goes_on = f"lock it; the arm goes home, and {following} is next"
        stands = ", ".join(dict.fromkeys(stored.record.kind for stored in engine.case.standing))
        value = (
            f"nobody is in the arm's way home; these results remain valid: {stands}",
            *work_begun_elsewhere(engine),
        )
        question = CART_MOVED.question(f"{problem.summary}: {goes_on}", "; ".join(value))
        if engine.ask(question) != GO_ON:
            return False
        if following is None or not engine.setting.workcell.place.is_home:
            engine.retreat_home()
        return True
