"""The message channel: events that a camera reports, such as missed triggers."""
