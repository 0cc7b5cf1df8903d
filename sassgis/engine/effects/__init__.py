"""Effects that the model of 1986 leaves out, one file each; they do not know each other.

An effect is a NamedTuple of parameters, whose ``form`` is 0 where it is off, and small kernels for
the hooks it needs: flight and way (per path), contact (changes the rebound), birth (new blocks).
The course of a rock is compiled twice: without any effect, and with all of them behind their
switches.
"""
