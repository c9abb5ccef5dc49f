"""The clinical side: from the CT series to the needle tip."""
