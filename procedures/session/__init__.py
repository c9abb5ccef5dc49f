"""A session of a case or a calibration: its engine, with its journal, recorders and guards, put together."""
