"""Which sensors a machine needs: every subset judged by the accuracy it gives and by its price."""
