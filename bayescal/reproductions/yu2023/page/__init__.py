"""Pages of simulated calibrations of hexapods."""
