"""Where we are in the procedure, and the journal that is written before anything happens."""
