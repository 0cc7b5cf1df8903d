"""The blind check: made worlds, sealed cases, scores of the answers."""
