"""Advice on settings, on the next measurements and on campaigns that are planned, in sentences.

In: a fitted hypothesis and a ``Verdict``, only tables, or only a configuration. Out: gaps of
models, settings, the first sentence, measurements, powers. Imports verdict, words and all rooms
before.
"""
