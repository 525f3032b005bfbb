"""Integration in free flight: extrapolated steps, error control, events, dense output."""
