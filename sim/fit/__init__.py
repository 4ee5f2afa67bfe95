"""A detector model fitted to recordings of known origins, and how like them it is."""
