"""Running the logger as a service: start, signals, watchdog, scheduling."""
