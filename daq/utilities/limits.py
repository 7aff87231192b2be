"""How much of anything is read: every bound on files and addresses of others in one place, each with its reason."""

TEXT_BYTES = 2**20
"""Bytes of a TOML file; the longest that this program writes, a model with all its effects, has some 30 kB."""
DATA_BYTES = 2**31
"""Bytes of a log that is read whole: a day at 100 Hz with forty channels."""
TREE_BYTES = 2**26
"""Bytes of a JSON or XML file: an estimate of 200 flights with histories has 20 MB, the largest aircraft of JSBSim 1 MB."""
TABLE_BYTES = 2**26
"""Bytes of a table that lists flights: half a million rows."""
TOML_DEPTH = 32
"""Tables within tables, and parts of one dotted key; the files described in docs/ need five."""
XML_DEPTH = 100
"""Elements within elements: aircraft of JSBSim have 15.

What reads a tree goes down by itself, and Python no further than 1000."""
XML_ELEMENTS = 500_000
"""The aircraft of JSBSim with the longest tables has 8,000."""
FLIGHTS = 100_000
"""Of one plan, whatever it names and simulates; each has a row, a page and seconds of work."""
LOOKED_AT = 1_000_000
"""Names that a pattern may have to be held against: a pattern over a whole computer is a slip."""
MODEL_LINES = 1000
"""Equations of a model; six degrees of freedom with every effect of the catalogue have 120."""
MODEL_DEPTH = 100
"""Equations that use one another in a chain; ours have 9."""
SILENCE_S = 20.0
"""Of a server that a flight is fetched from: then the flight counts as not to be had, and the others go on."""
SLOWEST_BYTES_PER_S = 1000
"""What it gives in the mean, from the first SILENCE_S on: a modem's rate."""
PROTOCOLS = frozenset("file http https ftp sftp ssh s3 s3a gs gcs az abfs abfss adl hdfs webhdfs memory".split())
"""Of addresses of flights. fsspec knows others that unpack, chain, cache or run what a file of somebody else says."""
