"""Pictures, films and pages of results."""
