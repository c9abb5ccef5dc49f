"""The theatre in three dimensions, posed here: the page multiplies nothing out."""
