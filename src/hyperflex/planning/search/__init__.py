"""The search for a throw: free swings, beam search, CMA-ES, and the contact phase."""
