"""Where the gap lies, which cause is the most probable, and how far the gap shrinks with it.

In: ``HypothesisFits``. Out: ``GapFinding``s, ``Evidence`` and a ``Verdict``. Imports fit, words,
diagnosis and all rooms before.
"""
