"""Figures of the pages, and their common style."""
