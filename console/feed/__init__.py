"""From events to what is shown: one pure fold, fed by the engine's socket or by the file of a run."""
