"""The browser view (extra `view`)."""
