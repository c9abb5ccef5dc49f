"""The engine's side of the browser console: its process, the operator's seat, the orders given from it."""
