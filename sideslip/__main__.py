"""`python -m sideslip`."""

from sideslip.entry import main

main()
