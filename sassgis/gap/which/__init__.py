"""Which cause the gap has: fingerprints tested and weighed, hypotheses, verdict."""
