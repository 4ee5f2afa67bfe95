collect_ignore = ["my_program", "my_tracker"]
