"""Several measurements of one machine, or of machines of one design: what they share, and what moved between them."""
