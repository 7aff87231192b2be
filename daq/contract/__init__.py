"""The air-to-ground contract: channel table, scan, recording format, wire format and dialect.

Everything here is plain data and codecs; no hardware library is imported.
"""
