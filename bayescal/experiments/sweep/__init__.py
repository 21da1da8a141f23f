"""Many experiments that differ in some keys of their config, and what becomes of their figures."""
