"""Observed rocks released again in a model, and what the observer records of them.

In: a ``Case`` and a ``HypothesisModel``. Out: simulated ``Campaign``s, in the form of the observed
one. Imports observations, and the engine.
"""
