"""The paper's identification methods and its baselines."""
