"""Look-up tables: what a machine's actuators have to do where elevation, temperature and the like change."""
