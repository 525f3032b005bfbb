"""Pictures: how moving shapes cover them during an exposure, and moments of blobs."""
