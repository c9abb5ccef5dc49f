"""Complete cases in randomly drawn worlds with at most one change each, judged against ground truth."""
