"""Programs of the controller: recognised scripts, carried out without an interpreter of URScript."""
