"""Sessions: one machine measured again and again, or several machines of one design, in one posterior."""
