"""The message channel of a camera: events to the application in control, repeated until acknowledged."""
