"""Figures of the pages: how they look, and each of them."""
