"""Awkward flights of aircraft of many sizes, flown by JSBSim, with the truth about their derivatives."""
