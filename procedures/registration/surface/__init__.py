"""Registration of a scanned surface to that in the CT, with what it says about its own error."""
