"""Advice on settings and on the next measurements, in sentences.

In: a fitted hypothesis and a ``Verdict``, or only tables. Out: gaps of models, settings, the first
sentence, measurements. Imports fit, words, diagnosis and all rooms before; no verdicts are made.
"""
