"""Effects that the model of 1986 leaves out, one file each; they do not know each other.

An effect is its settings, a NamedTuple of numbers for the kernel, whose ``form`` is 0 where it is
off, and small kernels that the hooks call (``hooks.py``). Values that differ from place to place
are in the rows of the ground and of the stretches. The motion is compiled twice: without any
effect, and with all of them behind their forms.
"""
