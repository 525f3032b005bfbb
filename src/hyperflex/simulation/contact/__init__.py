"""Runs with contact: free flight, contact steps, and checks of the start."""
