"""Load generator that decodes a camera image repeatedly to keep one processor busy."""

from __future__ import annotations

import json
import os

from sim.world.process import end_with_parent

SIZE_PX = (1088, 2048)


def main() -> None:
    import cv2
    import numpy as np

    end_with_parent(lambda: os._exit(0))
    cv2.setNumThreads(1)
    picture = np.random.default_rng(0).integers(0, 255, SIZE_PX, dtype=np.uint8)
    _, encoded = cv2.imencode(".jpg", picture)
    print("READY " + json.dumps({}), flush=True)
    while True:
        cv2.imdecode(encoded, cv2.IMREAD_GRAYSCALE)


if __name__ == "__main__":
    main()
