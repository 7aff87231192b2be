"""What air and ground agree on in files: the MCAP recording, how it is read, checked and salvaged."""
