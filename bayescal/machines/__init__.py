"""Machines: mechanisms, kinematic models, deformations, sensors and readings."""
