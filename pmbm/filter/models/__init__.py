"""The parts of the tracker's model, one file a part; `protocols` says what each owes."""
