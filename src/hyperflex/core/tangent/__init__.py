"""Forward sensitivities: derivatives of a step, of its dense output and of events, along given directions."""
