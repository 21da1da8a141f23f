"""The identifiability audit: what measurements determine of a machine, before it is built and after."""
