"""The blind check: synthetic sites, blinded cases, scores of the answers."""
