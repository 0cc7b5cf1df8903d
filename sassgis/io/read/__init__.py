"""Readers: configuration, terrain, vectors, ground, forest, objects, observations."""
