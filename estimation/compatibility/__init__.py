"""Data compatibility: do accelerations, rates, attitude and air data of a flight tell the same story?"""
