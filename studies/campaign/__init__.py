"""Common parts of all campaigns: units of work, workers, ledger, tables and plots."""
