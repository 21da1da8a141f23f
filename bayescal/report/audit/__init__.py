"""The report of an audit: from its directory to one page."""
