"""Yu, Wu and Wang (2023): simulated calibrations of hexapods."""
