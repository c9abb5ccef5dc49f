"""The engine of a case or a calibration, with its journal, recorders and guards, put together."""
