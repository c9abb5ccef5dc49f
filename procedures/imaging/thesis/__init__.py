"""The thesis' localizer, for comparison with ours on the same data. Not for patients."""
