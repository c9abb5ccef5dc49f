"""From events to the displayed state: one pure fold, fed by the engine's socket or by a run's file."""
