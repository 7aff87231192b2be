"""What is kept of a session: journal, recording, the papers that came down, and the disk they go to."""
