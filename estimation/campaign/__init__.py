"""Campaigns: many flights, estimated one by one on an engine that may span machines, then compared with each other.

A plan names the flights and the conditions of each. Every piece of work has a key made of its content; work whose key is in the
output folder already is not done again. Results are Parquet tables of the schema in `schema`.
"""
