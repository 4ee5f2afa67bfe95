"""Results to Markdown and HTML."""
