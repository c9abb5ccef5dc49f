"""The control side of a camera (GVCP): registers, privileges, answers, and the XML that describes them."""
