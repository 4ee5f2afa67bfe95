"""Traffic of highway-env: the one door to it, and the same motion, to the bit, of all vehicles."""
