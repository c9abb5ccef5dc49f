"""The message channel of a camera: events to the controlling application, repeated until acknowledged."""
