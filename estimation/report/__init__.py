"""Self-contained HTML pages of results: one file each, figures inline, readable without a network."""
