"""Runs beside pegs: free flight and contact, and what is checked before."""
