"""`python -m sideslip`."""

import sys
from pathlib import Path

# Python searches the working folder first, where a file like estimation.py would hide our package of that name.
sys.path.insert(0, str(Path(__file__).parents[1]))

from sideslip.entry import main

main()
