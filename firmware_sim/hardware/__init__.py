"""From truth to bytes: instruments, chip registers, the bus, serial lines, the radio, the card, and their faults."""
