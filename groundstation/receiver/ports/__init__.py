"""Where bytes come in: serial, UDP, files, each with an allowance of memory."""
