"""What was observed on a slope: tables, checks, places on fall lines."""
