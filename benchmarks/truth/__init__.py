"""Whether intervals hold the truth where machines err in a way that no model states; see README.md."""
