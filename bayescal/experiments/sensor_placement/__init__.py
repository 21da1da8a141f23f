"""Which sensors to buy."""
