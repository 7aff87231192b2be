"""Through a servo driver of our own behind a multiplexer: driver, heartbeat, pilot's signals, trial before a flight."""
