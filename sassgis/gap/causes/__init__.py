"""Causes of a gap: one file each with its hypotheses and fingerprints, listed in ``all_causes``.

In: a ``Case`` and its ``ResidualTable``. Out: drawn models (``CausePart``) and ``Scores`` whose
mean is zero where the cause is absent. Imports observations, forward, residuals, and the engine.
"""
