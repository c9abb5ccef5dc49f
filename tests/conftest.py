"""What all tests share."""

import gc

from hypothesis import settings

pytest_plugins = ["hazard_ledger"]

settings.register_profile("suite", deadline=None)  # how long an example takes says how busy the computer is
settings.load_profile("suite")

gc.disable()  # while tests are collected, little is garbage


def pytest_collection_finish() -> None:
    """What was collected stays to the end: from here on no search for garbage looks at it again."""
    gc.freeze()
    gc.set_threshold(50_000)  # a search after every 700 objects finds next to nothing
    gc.enable()
