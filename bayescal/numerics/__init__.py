"""Arrays and nothing else: geometry and scratch memory."""
