"""What all kinds of experiment have in common, done once."""
