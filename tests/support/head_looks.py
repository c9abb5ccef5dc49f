"""True stereo heads and what they see of a ball, from `benchmarks`, which is not an installed package."""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
if str(ROOT) not in sys.path:
    sys.path.append(str(ROOT))

from benchmarks.head_looks import ENDPOINTS, TrueHead, observation_set, true_head  # noqa: E402

__all__ = ["ENDPOINTS", "TrueHead", "observation_set", "true_head"]
