"""Contact with pegs, walls and grounds: Moreau-Jean time stepping with Coulomb friction."""
