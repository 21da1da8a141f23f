"""What several kinds of experiment read their inputs with."""
