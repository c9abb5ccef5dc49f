"""What all tests share."""

pytest_plugins = ["hazard_ledger"]
