collect_ignore = ["my_tracker"]
