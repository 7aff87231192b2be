"""Physical constants, units and a quantile, each once for all packages: exact by definition unless a line says otherwise; and
bounds that logger and ground station share."""

import math

GRAVITY = 9.80665  # m/s2, standard (CGPM 1901)
ZERO_CELSIUS = 273.15  # K

# dry air and the standard atmosphere: ICAO Doc 7488/3
GAS_CONSTANT = 287.05287  # J/(kg K)
HEAT_RATIO = 1.4
SEA_LEVEL_PRESSURE = 101325.0  # Pa
SEA_LEVEL_TEMPERATURE = 288.15  # K
SEA_LEVEL_DENSITY = 1.225  # kg/m3, that equivalent and calibrated airspeed refer to
LAPSE_RATE = 0.0065  # K/m, to 11 km

EARTH_RADIUS = 6371008.8  # m, mean (IUGG)
ROUND_EARTH_RADIUS = 6_371_000.0  # m, where a map of a few kilometres needs no more

# what a pitot reads in flight, by the speed over ground
FLYING_GROUND_SPEED = 8.0  # m/s, that only flight gives: small aircraft lift off at it
LEAST_PITOT_PRESSURE = -20.0
"""Pa: no tube in front of its static port reads less, wake and zero error together are below it."""
LEAST_PITOT_SHARE = 0.1
"""Of the dynamic pressure of the ground speed: less is a tail wind of two thirds of it, or a cover."""

FOOT = 0.3048  # m
INCH = 0.0254  # m
NAUTICAL_MILE = 1852.0  # m
MILE_PER_HOUR = 0.44704  # m/s
KNOT = NAUTICAL_MILE / 3600  # m/s
POUND = 4.4482216152605  # N, of force
SLUG = 14.593902937206  # kg, rounded
PSI = 6894.757293168  # Pa
INCH_OF_WATER = 249.08891  # Pa, of water at 4 degC

NORMAL_95 = 1.96  # standard deviations from the mean to either end of a normal distribution's central 95 %

DEGREE = math.pi / 180  # rad
RADIAN = 180 / math.pi  # deg
