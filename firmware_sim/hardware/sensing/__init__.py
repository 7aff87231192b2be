"""What each instrument sees of the simulated aircraft, before its chip puts it into registers."""
