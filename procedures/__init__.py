"""The clinical procedure, from the CT series to the needle tip."""
