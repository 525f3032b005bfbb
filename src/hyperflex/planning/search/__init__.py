"""The search for a cast: free swings, beam search, CMA-ES, and the run beside the peg."""
