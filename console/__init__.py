"""What an operator sees in a browser: a case while it runs, and afterwards."""
