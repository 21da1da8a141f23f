"""Measurements: poses, photogrammetry and their simulation."""
