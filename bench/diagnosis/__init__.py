"""What the user of `bench diagnose` sees: a page, a Markdown text, JSON, a summary."""
