"""The digest of a question as it is shown: an answer quotes it, so nobody confirms what was not shown."""

from __future__ import annotations

import hashlib
import json

from procedures.engine.events.happenings import Questioned


def shown_digest(question: Questioned) -> str:
    """SHA-256, in hexadecimal, of everything of a question that is decided on."""
    content = question.model_dump(
        mode="json",
        include={"question", "topic", "subject", "value", "answers", "evidence", "read_back", "reads"},
    )
    return hashlib.sha256(json.dumps(content, sort_keys=True, ensure_ascii=False).encode()).hexdigest()
