"""Shared infrastructure of the studies: units of work, workers, ledger, tables and plots."""
