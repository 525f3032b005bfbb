"""Forward sensitivities of a step, its dense output and events along given directions."""
