"""Pictures: where points are seen, how moving shapes cover pixels during an exposure, and moments of blobs."""
