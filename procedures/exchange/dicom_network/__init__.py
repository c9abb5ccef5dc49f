"""CT series from the hospital's network and objects back to it: receiver, inbox, and requests to a peer."""
