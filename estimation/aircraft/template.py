"""The file that `sideslip aircraft new` writes: every key with unit, sign and meaning, for the user to fill in."""

import json

TEMPLATE = """# Aircraft {title}. Take the # away from a line and write its number; what is not known stays as it is.
# SI and radians; body axes x forward, y right, z down, origin at the CG. `sideslip aircraft check {file}` says what
# is missing, doubtful, or enough for which method. All keys: docs/aircraft.md.
name = {name}
# title = "what stands above tables and figures"

# Reference lengths and area that make coefficients of forces and moments. Every model with derivatives needs them.
[geometry]
# span = 0.0          # m, b
# area = 0.0          # m2, S, of the wing
# chord = 0.0         # m, c, mean aerodynamic chord
# cg_from_nose = 0.0  # m, where the origin of all positions lies

# Mass as flown, moments of inertia about the CG. Weigh it; swing it or compute it. `lateral-simple` does without Iyy.
[mass]
# mass = 0.0          # kg
# Ixx = 0.0           # kg m2
# Iyy = 0.0           # kg m2
# Izz = 0.0           # kg m2
# Ixz = 0.0           # kg m2, positive where the principal axis points nose down; 0 where not known

# Where the instruments are, from the CG: x forward, y right, z down [m].
[sensors]
# imu = [0.0, 0.0, 0.0]
# alpha_vane = [0.0, 0.0, 0.0]
# beta_vane = [0.0, 0.0, 0.0]
# pitot = [0.0, 0.0, 0.0]
# gps = [0.0, 0.0, 0.0]

# Shape of a conventional aircraft, from which derivatives not stated below are computed by handbook methods, good to a
# third: better starts than zeros. Leave the whole table out for an unusual one.
# [shape]
# speed = 0.0             # m/s at which it flies level
# wing_ac = 0.0           # m, aerodynamic centre of the wing from the CG, + forward
# taper = 1.0             # tip chord over root chord
# sweep = 0.0             # rad, of the half-chord line
# dihedral = 0.0          # rad
# tail_area = 0.0         # m2, horizontal tail with elevator
# tail_span = 0.0         # m
# tail_arm = 0.0          # m, CG to the tail's quarter chord, + aft
# elevator_flap = 0.4     # elevator chord over tail chord
# fin_area = 0.0          # m2, fin with rudder
# fin_span = 0.0          # m, its height
# fin_arm = 0.0           # m, CG to the fin's quarter chord, + aft
# fin_height = 0.0        # m, its centre of pressure above the CG
# rudder_flap = 0.4       # rudder chord over fin chord
# aileron = [0.6, 0.95]   # inner and outer end, fractions of the half span
# aileron_flap = 0.25     # aileron chord over wing chord

# What is believed before flying, per rad, rates as pb/2V, qc/2V, rb/2V: printed beside the estimates and where they start from.
# source: "wind tunnel", "engineering estimate", "flight", "computed" or "handbook". All may be left out.
# Signs: + delta_e trailing edge down, + delta_a rolls left, + delta_r trailing edge to port.
[derivatives]
# Cl_p = {{ value = -0.45, std = 0.1, source = "engineering estimate" }}

# Deflection of each surface at full stick [rad], one number where it is the same both ways: for simulators, by `sideslip export`.
[throws]
# delta_e = 0.0           # rad
# delta_a = 0.0           # rad, half of what right and left differ by
# delta_r = [-0.4, 0.3]   # rad, least and greatest where they differ

# The rest is for `sideslip fly`, and `export` (static_thrust): what a simulated aircraft of this kind is made of.
# [servos]
# lag = 0.035             # s, first-order lag of a servo arm
# rate = 6.0              # rad/s, fastest an arm turns
# elevon_limit = 0.35     # rad, largest command
# rudder_limit = 0.35     # rad
# [engine]
# static_thrust = 0.0     # N at full throttle standing still
# thrust_fall = 0.0       # N lost per m/s of airspeed at full throttle
# lag = 0.15              # s
# [simulation]
# speed = 0.0             # m/s at which it flies level with the elevons in line
# speed_range = [0.0, 0.0] # m/s, slowest and fastest it can be flown at
# [simulation.derivatives] # those it flies with where they are not the believed ones
"""


def template(name: str, file: str) -> str:
    """The text of a new aircraft file."""
    return TEMPLATE.format(title=name, file=file, name=json.dumps(name, ensure_ascii=False))
