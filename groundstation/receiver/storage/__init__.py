"""Storage of a session: its journal, recording and papers, and their files on a disk that may fail."""
