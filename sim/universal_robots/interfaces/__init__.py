"""Client interfaces and dashboard: robot state, messages, scripts, commands."""
