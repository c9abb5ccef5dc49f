"""Conformance suites for each kind of device, independent of driver and endpoint; safe by default.

A suite is a list of small cases (`case.py`): the generic ones, then those of the driver's wire protocol
(`protocol.py`). The command `ronna-conformance` resolves the device to test (`target.py`) and runs them on it
(`device_under_test.py`).
"""
