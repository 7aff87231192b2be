"""The MAVLink 2 dialect of the link: definition (`sideslip.xml`), module made from it, and the maker (`generate`).

`own_messages.xml` is written by hand; the scan messages are derived from the channel table; the standard messages
are taken unchanged from the definitions that pymavlink ships.
"""
