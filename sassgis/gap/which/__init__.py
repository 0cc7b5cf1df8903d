"""Which effect causes the gap: hypotheses, campaigns, signatures, verdict."""
