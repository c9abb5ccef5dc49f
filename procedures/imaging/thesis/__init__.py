"""The thesis' localizer, to be measured beside ours on the same data. Not for patients."""
