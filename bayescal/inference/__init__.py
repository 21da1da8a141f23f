"""From a posterior to its draws and its evidence."""
