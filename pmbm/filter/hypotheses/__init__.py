"""From the global hypotheses before a scan to those after it: gating, branching, clusters."""
