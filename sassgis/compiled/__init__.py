"""Compiled code and random numbers.

The decorators of the kernels, the cache of their machine code, counter-based draws.
May import: sassgis.errors, sassgis.grid, numba.
"""
