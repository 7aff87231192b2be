"""What moves the controls on board: the servo driver, the heartbeat that enables it, and the sequencer that flies a manoeuvre."""
