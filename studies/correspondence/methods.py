"""Correspondence methods selected by an option: ours, the thesis', and user methods."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches

from studies.campaign.silence import Tell
from studies.correspondence.study import Method
from studies.errors import MethodRefused
from studies.own.contracts import MethodKind
from studies.own.method import OwnMethod, installed
from studies.own.trial import tried_apart

NAMES = {
    "clique": Method.CLIQUE,
    "orientation": Method.PRIOR,
    "count": Method.COUNT,
    "thesis": Method.THESIS,
    "thesis-validated": Method.VALIDATED,
}


def chosen_methods(
    names: Sequence[str], tell: Tell = lambda text: None
) -> tuple[tuple[Method, ...], tuple[OwnMethod, ...]]:
    """Known methods and user methods; all known ones if none is named. Raises STU-012 to STU-014.

    `tell` is called with the name of a user method that does not respond.
    """
    if not names:
        return tuple(Method), ()
    wanted = tuple(dict.fromkeys(names))
    unknown = [name for name in wanted if name not in NAMES]
    for name in unknown:
        if ":" not in name and name not in (there := installed()):
            known = [*NAMES, *there]
            near = get_close_matches(name, known, n=1)
            raise MethodRefused(
                f"--method: there is no method {name!r}",
                expected=f"{', '.join(known)} or module:function",
                action=f"Did you mean {near[0]}? {MethodRefused.action}" if near else None,
            )
    own = tuple(tried_apart(MethodKind.PAIRING, name, tell) for name in unknown)
    return tuple(NAMES[name] for name in wanted if name in NAMES), own
