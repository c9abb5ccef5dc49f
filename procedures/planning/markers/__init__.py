"""Places of markers on the head: where they help most, whether they can be told apart, the template."""
