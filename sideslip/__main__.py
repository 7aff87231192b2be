"""`python -m sideslip`."""

from sideslip.cli import main

main()
