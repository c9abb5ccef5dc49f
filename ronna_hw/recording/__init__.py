"""What passed on the links of a theatre, kept for whoever has to explain it afterwards."""
