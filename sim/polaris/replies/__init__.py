"""A frame as the text of TX or the bytes of BX."""
