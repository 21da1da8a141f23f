"""After the poses measured so far: what is known, which pose to measure next, and whether to stop."""
