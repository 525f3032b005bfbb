"""References for the tests: the same physics by another derivation, in plain numpy."""
