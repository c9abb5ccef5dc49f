"""Sections of the report: each a typed model that the template of the same name prints."""
