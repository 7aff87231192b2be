"""From rows and words to HTML: pages, and tables folded to a sheet."""
