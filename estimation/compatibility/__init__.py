"""Data compatibility: do the accelerations, rates, attitude and air data of a flight agree?"""
