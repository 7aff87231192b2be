"""Campaigns: many flights, estimated one by one on an engine that may span machines, then looked at together.

A plan names flights and what is known of each; every piece of work has a key made of its content, and what lies in the
output folder under its key is not done again. Results are Parquet tables of a stated schema.
"""
