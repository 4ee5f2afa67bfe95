"""Why the tracker reports what it reports: its hypotheses, and one track's life in words."""
