"""What several test files share: small terrains, made-up results, ways to call the program."""
