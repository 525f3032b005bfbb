"""The paper's methods and what it compares them with."""
