"""Files, tables of settings, printed tables and progress bars, for any kind of content."""
