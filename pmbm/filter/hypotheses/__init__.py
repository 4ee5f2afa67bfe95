"""Global hypotheses over one scan: gating, branching, clusters."""
