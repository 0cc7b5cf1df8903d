"""Observed rocks released again in a model, and what the observer records of them."""
