"""Limits on input: bounds on the size and depth of files and on addresses, each with its reason."""

TEXT_BYTES = 2**20
"""Bytes of a TOML file; the longest that this program writes, a model with all its effects, has some 30 kB."""
DATA_BYTES = 2**31
"""Bytes of a log that is read into memory: a day at 100 Hz with forty channels."""
TREE_BYTES = 2**26
"""Bytes of a JSON or XML file: an estimate of 200 flights with histories has 20 MB, the largest aircraft of JSBSim 1 MB."""
TABLE_BYTES = 2**26
"""Bytes of a table that lists flights: half a million rows."""
TOML_DEPTH = 32
"""Tables within tables, and parts of one dotted key; the files described in docs/ need five."""
XML_DEPTH = 100
"""Elements within elements: aircraft of JSBSim have 15, and the recursive readers of a tree reach Python's limit at 1000."""
XML_ELEMENTS = 500_000
"""Elements of an XML file: the aircraft of JSBSim with the longest tables has 8,000."""
FLIGHTS = 100_000
"""Flights of one plan, named and simulated; each has a row, a page and seconds of work."""
LOOKED_AT = 1_000_000
"""File names that are compared with a pattern: a pattern over a whole computer is a mistake."""
MODEL_LINES = 1000
"""Equations of a model; six degrees of freedom with every effect of the catalogue have 120."""
MODEL_DEPTH = 100
"""Length of a chain of equations that use one another; ours have 9."""
SILENCE_S = 20.0
"""Longest silence of a server from which a flight is fetched [s]; after it the flight counts as unavailable."""
SLOWEST_BYTES_PER_S = 1000
"""Least mean rate of that server after the first SILENCE_S: a modem's."""
PROTOCOLS = frozenset("file http https ftp sftp ssh s3 s3a gs gcs az abfs abfss adl hdfs webhdfs memory".split())
"""Protocols in addresses of flights. Others of fsspec unpack, chain, cache, or run what another person's file contains."""
