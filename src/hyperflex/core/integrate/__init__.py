"""Integration without contact: extrapolated steps, error control, events, dense output."""
