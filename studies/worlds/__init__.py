"""Whole cases in worlds drawn at random, with one change in each, judged by the truth."""
