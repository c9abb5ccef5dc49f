"""Common parts of all study campaigns: units of work, workers, ledger, tables and plots."""
