"""One suite per kind of device, for any driver on any endpoint, hardware included; safe by default.

A suite is a list of small cases (`case.py`) that run on a dut (`dut.py`), which makes devices through the
registry. `ronna-conformance` is its command.
"""
