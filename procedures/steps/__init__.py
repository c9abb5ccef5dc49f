"""One module per clinical step."""
