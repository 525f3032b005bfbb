"""The demo: a bundled recording to an identified rope to a cast that winds, with its report."""
