"""The answer of the workflow: data and words."""
