"""What is fitted: free parameters, and predicted measurements with their derivatives."""
