"""A booted Linux without hardware: `python -m tests.rig` (`make rig`). What of it needs no QEMU is tested by `test_*.py` here."""
