"""The 2D engine: one block, a rigid ellipse, over a profile of straight segments.

Axes: chainage x to the right, height z up; angles of the ellipse counter-clockwise, spin ω
clockwise positive, so that a block rolling to the right has ω > 0. SI units. Energies are per unit
mass until they are written to a result.
"""
