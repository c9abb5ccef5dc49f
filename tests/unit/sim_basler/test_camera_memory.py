"""The allocator setting that halves the cost of an image must take effect."""

import subprocess
import sys

SCRIPT = """
import resource, threading
import numpy as np
from sim.basler.command import keep_freed_memory

def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(20):
        np.ones((1024, 1024), np.float32) * 2
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

kept = keep_freed_memory()
faults()
found = []
thread = threading.Thread(target=lambda: (faults(), found.append(faults())))
thread.start()
thread.join()
print(kept, found[0])
"""


def test_freed_memory_is_reused_with_few_page_faults() -> None:
    ended = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    kept, faults = ended.stdout.split()
    assert kept == "True"
    assert int(faults) < 200  # 40 arrays of 1024 pages each
