"""`python -m bayescal.cli`."""

from bayescal.cli import main

main()
