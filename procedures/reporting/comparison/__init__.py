"""Comparison of two runs: what differed before they began, and what came of it."""
