"""Simulated campaigns: the observed rocks released again in a model of a hypothesis."""
