"""The answer as a page with pictures and tables, and as a rerun recording."""
