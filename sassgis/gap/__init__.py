"""The gap between simulated and observed rocks: where, by which effect, and how far it shrinks."""
