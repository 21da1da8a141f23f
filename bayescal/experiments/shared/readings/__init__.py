"""Machines known by what their channels read: configs and tables to posteriors, whatever the kind of experiment."""
