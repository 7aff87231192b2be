"""What air and ground agree on over the radio: wire format, dialect, command numbers, scan maps."""
