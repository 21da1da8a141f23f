"""Projects to begin with: commented configs of a made-up machine with simulated data, which run as they are."""
