"""Control channel of a camera (GVCP): registers, privilege, acknowledges, and the GenICam XML."""
