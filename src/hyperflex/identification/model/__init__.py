"""Free parameters, and predicted measurements with their derivatives."""
