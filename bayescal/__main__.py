"""`python -m bayescal`."""

from bayescal.cli import main

main()
