"""What measurements can tell of a machine: rank, information, ridges, requirements."""
