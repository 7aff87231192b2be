"""`python -m sideslip`."""

import sys
from pathlib import Path

# Python puts the working folder first: there a file like estimation.py would stand for our package of that name.
sys.path.insert(0, str(Path(__file__).parents[1]))

from sideslip.entry import main

main()
